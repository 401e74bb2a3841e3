"""Among designs that cost nearly the same, the one that a practitioner accepts.

An optimum says nothing about its neighbours: a PI may cost half a per cent more than the best of all fractional
controllers, and is what one would rather look after. So simpler ones are tried, and what was given up is said.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

from fopid_core.design.defaults import LEAST_PROPORTIONAL, PRACTICAL_ORDERS
from fopid_core.design.specification import NUMBERS, STRUCTURES
from fopid_core.design.time.specification import TimeSpecification
from fopid_core.design.time.tuning import TimeDesign

EQUAL = 0.003
"""Designs whose costs differ by no more, relative, are taken for equally good."""
HOPEFUL = 0.02
"""How far off the rough optimum of a simpler structure may be for it to be worth a search of its own."""
SIMPLER = ("pi", "pid", "fopi")
"""Tried in this order. Not those without integral action: what they leave of a load is not in every index."""
NEAR_ONE = 0.15
"""How near to 1 an order is for it to be tried there."""
PRACTICAL_WORTH = 0.1
"""By how much more one may cost whose kp and orders are off their edges."""

OFF_EDGES = "a fopid with kp and orders off their edges"

Search = Callable[[TimeSpecification], TimeDesign | None]


@dataclass(frozen=True)
class Preferred:
    """The design that is handed out.

    Attributes
    ----------
    design : TimeDesign
    structure : str
        Its name: one of ``STRUCTURES``, or what was kept.
    words : str
        What was preferred to what, empty when nothing was.
    """

    design: TimeDesign
    structure: str
    words: str = ""


def preferred(specification: TimeSpecification, best: TimeDesign, gain: float, search: Search) -> Preferred:
    """The simplest design that costs hardly more than the best.

    Parameters
    ----------
    specification : TimeSpecification
        What the best design was made for.
    best : TimeDesign
    gain : float
        Of the process.
    search : callable
        Finds the best design for a specification.
    """
    if not best.met:
        return Preferred(best, "fopid")
    words = ""
    for name, changed in _candidates(specification, best, gain):
        found = search(changed)
        worth = PRACTICAL_WORTH if name == OFF_EDGES else EQUAL
        if found is not None and found.met and found.cost <= (1.0 + worth) * best.cost:
            dearer = 100.0 * max(found.cost / best.cost - 1.0, 0.0)
            words = f"{name} preferred: it costs {dearer:.2g} % more than the best fopid ({best.controller})"
            return Preferred(found, name if name in STRUCTURES else "fopid", words)
        if name == OFF_EDGES:
            costs = (
                f"costs {100.0 * (found.cost / best.cost - 1.0):.2g} % more" if found and found.met else "was not found"
            )
            words = f"kp or an order is where few would trust it: {name} {costs}"
    return Preferred(best, "fopid", words)


def _candidates(
    specification: TimeSpecification, best: TimeDesign, gain: float
) -> Iterator[tuple[str, TimeSpecification]]:
    asked = {*specification.fixed, *specification.bounds} & {*NUMBERS}
    if asked:
        return  # whoever names numbers has chosen
    for name in SIMPLER:
        if name in best.simpler and best.simpler[name][0] <= (1.0 + HOPEFUL) * best.cost:
            yield name, _with(specification, STRUCTURES[name])
    lam, mu = best.controller.lam, best.controller.mu
    near = {name: 1.0 for name, order in (("lam", lam), ("mu", mu)) if abs(order - 1.0) <= NEAR_ONE}
    for name in near:
        yield f"fopid with {name} = 1", _with(specification, {name: 1.0})
    if not _is_practical(best, gain):
        sides = sorted((LEAST_PROPORTIONAL / gain, 1e3 / gain))
        ranges = {**PRACTICAL_ORDERS, "kp": (sides[0], sides[1])}
        yield OFF_EDGES, replace(specification, bounds={**specification.bounds, **ranges})


def _with(specification: TimeSpecification, numbers: Mapping[str, float]) -> TimeSpecification:
    return replace(specification, fixed={**specification.fixed, **numbers})


def _is_practical(design: TimeDesign, gain: float) -> bool:
    found = design.controller
    orders = {"lam": found.lam if found.ki else 1.0, "mu": found.mu if found.kd else 1.0}
    inside = all(low <= orders[name] <= high for name, (low, high) in PRACTICAL_ORDERS.items())
    return inside and abs(found.kp * gain) >= LEAST_PROPORTIONAL
