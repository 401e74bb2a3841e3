"""Which method, which structure: the comparison, from what people have at hand."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from fopid_core.api.reading import as_process
from fopid_core.design.comparison import compare as comparing

if TYPE_CHECKING:
    from fopid_core.api.reading import ProcessLike


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
