"""Which method, which structure, which trade-off: from what people have at hand."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from fopid_core.api.reading import as_process, refuse_unknown_of
from fopid_core.design.comparison import compare as comparing

if TYPE_CHECKING:
    from fopid_core.api.reading import ProcessLike
    from fopid_core.design.front.front import Front


def compare(process: ProcessLike, prefer: str = "balanced", **bounds: Any) -> comparing.Comparison:
    """Every tuning method and structure on one process, under the same bounds, and which to take.

    Parameters
    ----------
    process : Process, str or python-control object
    prefer : str
        ``balanced``, ``load``, ``setpoint``, ``robust`` or ``quiet``.
    **bounds
        ``ms_max``, ``mt_max``, ``noise_max``, ``u_max``, ``sample_time``, ``horizon``, ``filter_order``; what is not
        given is chosen from the process.

    Returns
    -------
    Comparison
        Its ``rows``, which of them is ``recommended``, and the ``reason``.

    Examples
    --------
    >>> found = compare("1/(s+1)*exp(-0.5s)", ms_max=1.6)  # doctest: +SKIP
    >>> found.rows[found.recommended].candidate.structure  # doctest: +SKIP
    'pid'
    """
    return comparing.compare(comparing.comparison_request(as_process(process), **bounds), prefer)


def front(process: ProcessLike, structure: str = "fopid", points: int = 200, **options: Any) -> Front:
    """The whole trade-off between load performance, robustness and control effort, not one point of it.

    Parameters
    ----------
    process : Process, str or python-control object
    structure : str
        ``p``, ``pi``, ``pd``, ``pid``, ``fopi``, ``fopd`` or ``fopid``.
    points : int
        Designs asked for.
    **options
        ``ms_min`` and ``ms_max``, ``noise_max``, ``mt_max``, ``horizon``, ``filter_order``, ``sample_time``.

    Returns
    -------
    Front
        Arrays of ``gains``, ``filter_time``, ``iae_load``, ``ms``, ``mt``, ``noise_gain``; ``best(ms_max=1.4)`` says
        which design has the least IAE within bounds, ``loop(index)`` gives its loop.

    Examples
    --------
    >>> found = front("1/(s+1)^3", "pi", points=20)
    >>> bool(found.ms[found.best(ms_max=1.5)] <= 1.5)
    True
    """
    from fopid_core.design.front.front import front as following

    refuse_unknown_of(following, options)
    return following(as_process(process), structure, points, **options)
