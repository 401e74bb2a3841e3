"""What an experiment asks of the tuner, as ``~/tune`` of the tuner's node takes it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from fopid_core.design.specification import STRUCTURES, Bound, TuningRequest, one_of, require
from fopid_core.model.process import Process

TIMEOUT = 30.0
"""Of the tuner's node [s]."""
WEIGHTS = ("chosen", "one")


@dataclass(frozen=True)
class TuneCall:
    """What the tuner is asked at the start of a phase; zero or empty leaves it to the tuner.

    The bound of ``t_max_db`` on |T| begins at ``t_max_frequency`` [rad/s], that of ``s_max_db`` on |S| ends at
    ``s_max_frequency``.
    """

    method: str = "frequency"
    phase_margin_deg: float = 0.0
    crossover: float = 0.0
    t_max_db: float = 0.0
    t_max_frequency: float = 0.0
    s_max_db: float = 0.0
    s_max_frequency: float = 0.0
    index: str = ""
    ms_max: float = 0.0
    u_max: float = 0.0
    horizon: float = 0.0
    via: str = ""
    rule: str = ""
    input: str = ""
    structure: str = ""
    mt_max: float = 0.0
    noise_max: float = 0.0
    filter_order: int = 0
    setpoint_weights: str = ""
    timeout: float = 0.0

    def request(self, process: Process, sample_time: float) -> TuningRequest:
        """The core's request, as the tuner's node makes it with its parameters at their defaults.

        Raises
        ------
        InputError
            Naming the field that cannot be used.
        """
        require(0.0 <= self.phase_margin_deg < 180.0, "phase_margin_deg", self.phase_margin_deg, "above 0, below 180")
        if self.index:
            from fopid_core.design.time.objectives import OBJECTIVES

            one_of("index", self.index, OBJECTIVES)
        if self.rule:
            from fopid_core.design.rules import rule_names

            one_of("rule", self.rule, rule_names())
        if self.structure:
            one_of("structure", self.structure, tuple(STRUCTURES))
        if self.setpoint_weights:
            one_of("setpoint_weights", self.setpoint_weights, WEIGHTS)
        return TuningRequest(
            process,
            method=self.method,
            phase_margin=math.radians(self.phase_margin_deg) or None,
            crossover=self.crossover or None,
            t_max=_bound("t_max", self.t_max_db, self.t_max_frequency),
            s_max=_bound("s_max", self.s_max_db, self.s_max_frequency),
            index=self.index or "itae",
            ms_max=self.ms_max or None,
            u_max=self.u_max or None,
            horizon=self.horizon or None,
            via=self.via or "none",
            rule=self.rule or None,
            input=self.input or "setpoint",
            structure=self.structure or None,
            mt_max=self.mt_max or None,
            noise_max=self.noise_max or None,
            filter_order=self.filter_order,
            two_degrees=self.setpoint_weights == "chosen" if self.setpoint_weights else None,
            sample_time=sample_time,
            timeout=self.timeout or TIMEOUT,
        )


def _bound(name: str, db: float, frequency: float) -> Bound | None:
    require(bool(frequency) or not db, f"{name}_frequency", frequency, f"above 0 rad/s, since {name}_db is given")
    return Bound(db, frequency) if frequency else None
