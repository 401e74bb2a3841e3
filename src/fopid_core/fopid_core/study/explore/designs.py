"""Designs by two wishes: how robust, and with how much control; for several structures side by side.

Each is the optimum of ``design.time`` for its bounds: the sum of the IAE of a setpoint and a load step is made small
with max |S| and the control's peak bounded. One optimum is near the next, so that a design follows a slider.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

from fopid_core.design import defaults
from fopid_core.design.specification import TuningRequest, one_of
from fopid_core.design.time.proposal import time_specification
from fopid_core.design.time.specification import TimeSpecification
from fopid_core.design.time.tuning import TimeDesign, tune_time
from fopid_core.errors import InputError
from fopid_core.model.process import Process

STRUCTURES = ("pi", "pid", "fopid")
MS_RANGE = (1.1, 2.5)
"""From robust to aggressive; practice takes 1.4 to 2."""

EFFORT_RANGE = (1.0, defaults.U_MAX)
"""From slow to fast: the control's peak, times the control that holds the setpoint."""

_NOTHING = 1e-9
FRONT_MS = (1.2, 1.3, 1.4, 1.5, 1.6, 1.8, 2.0, 2.3)


@dataclass
class Designs:
    """The designs of one process; each search begins at the nearest one found before.

    Parameters
    ----------
    process : Process
    sample_time : float
        Tick of the controller as it will run [s].
    """

    process: Process
    sample_time: float = 0.01
    _found: dict[str, dict[tuple[float, float], TimeDesign]] = field(default_factory=dict)

    @property
    def effort_unit(self) -> float:
        """The control that holds the setpoint, or what stands for it in a process that does not settle."""
        try:
            return 1.0 / abs(defaults.process_gain(self.process))
        except InputError:  # infinite at some frequency
            return 1.0

    def of(self, structure: str, ms_max: float, effort: float) -> TimeDesign | None:
        """The best controller of a structure under two bounds.

        Parameters
        ----------
        structure : str
            pi, pid or fopid.
        ms_max : float
            Bound on max |S|.
        effort : float
            Bound on the control's peak after a unit setpoint step, in ``effort_unit``.

        Returns
        -------
        TimeDesign or None
            None where no stable one was found; one with ``met`` false breaks a bound.

        Examples
        --------
        >>> designs = Designs(Process.parse("1/(s+1)^3"))
        >>> design = designs.of("pid", 1.6, 5.0)
        >>> design.met, round(design.ms, 3), round(design.control_peak, 1)
        (True, 1.6, 5.0)
        """
        one_of("structure", structure, STRUCTURES)
        wanted = (round(ms_max, 4), round(effort, 4))
        found = self._found.setdefault(structure, {})
        if wanted not in found:
            design = self._search(structure, *wanted)
            if design is None:
                return None
            found[wanted] = design
        return found[wanted]

    def _search(self, structure: str, ms_max: float, effort: float) -> TimeDesign | None:
        bounds = {"ms_max": ms_max, "u_max": effort * self.effort_unit, "sample_time": self.sample_time}
        request = TuningRequest(self.process, "time", index="iae", input="both", structure=structure,
                                two_degrees=False, **bounds)  # type: ignore[arg-type]  # fmt: skip
        specification = time_specification(request)
        near = sorted(self._found[structure].items(), key=lambda item: _distance(item[0], (ms_max, effort)))
        good = [design for _, design in near if design.met][:2]
        best = self._from(specification, good) if good else None
        if best is None or not best.met:
            again = tune_time(self.process, specification)
            best = again if best is None or (again is not None and again.met) else best
        return best

    def _from(self, specification: TimeSpecification, near: list[TimeDesign]) -> TimeDesign | None:
        return tune_time(self.process, replace(specification), near=[design.variables for design in near])

    def front(self, structure: str, effort: float) -> list[dict[str, Any]]:
        """The trade-off of a structure: for each bound on max |S| the best controller, as JSON knows it."""
        middle = sorted(FRONT_MS, key=lambda ms: abs(ms - defaults.MS_MAX))
        designs = {ms: self.of(structure, ms, effort) for ms in middle}
        return [
            described(structure, ms, design) for ms in FRONT_MS if (design := designs[ms]) is not None and design.met
        ]


def _distance(one: tuple[float, float], other: tuple[float, float]) -> float:
    return abs(math.log(one[0] / other[0])) + abs(math.log(one[1] / other[1]))


def _readable(value: float, beside: float) -> float:
    """Five digits, and 0 for what a search leaves of a gain it does without."""
    return 0.0 if abs(value) < _NOTHING * beside else float(f"{value:.5g}")


def described(structure: str, ms_max: float, design: TimeDesign | None) -> dict[str, Any]:
    """A design as JSON knows it, its gains with five digits; null where there is none."""
    if design is None:
        return {"structure": structure, "ms_max": ms_max, "met": False, "gains": None, "cost": None, "ms": None,
                "control_peak": None}  # fmt: skip
    sizes = [abs(getattr(design.controller, name)) for name in ("kp", "ki", "kd")]
    gains = {name: _readable(getattr(design.controller, name), max(sizes)) for name in ("kp", "ki", "kd", "lam", "mu")}
    return {"structure": structure, "ms_max": ms_max, "met": design.met, "gains": gains, "cost": design.cost,
            "ms": design.ms, "control_peak": design.control_peak}  # fmt: skip
