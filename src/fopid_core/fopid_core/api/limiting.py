"""How good a loop can be at all."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from fopid_core.api.reading import as_process, refuse_unknown_of
from fopid_core.design.limit import limit as limiting

if TYPE_CHECKING:
    from fopid_core.api.reading import ProcessLike


def limit(process: ProcessLike, index: str = "iae", **asked: Any) -> limiting.Limit:
    """What no linear controller goes below, under bounds on the loop.

    Parameters
    ----------
    process : Process, str or python-control object
        Stable or integrating.
    index : str
        ``iae`` or ``ise``.
    **asked
        ``input``, the unit step: ``load`` when not given, or ``setpoint``; ``ms_max``, ``mt_max``, ``noise_max``,
        ``sample_time``, ``horizon``, ``cells``, ``one_degree``.

    Returns
    -------
    Limit
        Its ``bound``, and ``resolution_error``, by how much a finer grid may raise it.

    Examples
    --------
    >>> limit("1/(s+1)*exp(-0.5s)", input="setpoint").bound
    0.5
    """
    refuse_unknown_of(limiting.limit, asked)
    return limiting.limit(as_process(process), index, **asked)
