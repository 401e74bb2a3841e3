"""What tunings came to, for the page: numbers that are known, and what to change where one failed."""

from __future__ import annotations

import math
from typing import Any

from fopid_msgs.action import Autotune
from fopid_msgs.msg import Gains, IdentifiedModel, LoopMeasures, Proposal, TuningResult
from fopid_ros.common.design_parameters import DEADBAND, GAINS, PACE, TWO_DEGREES

MEASURES = ("phase_margin", "crossover", "gain_margin_db", "delay_margin", "ms", "mt")

ADVICE = {
    "": "Have a controller run in automatic mode, with gains that hold the loop, and start again.",
    "measuring": "Let the loop come to rest: leave the setpoint alone and calm what disturbs it, or allow a larger "
    "deviation.",
    "exciting": "Allow a larger deviation, or choose a smaller amplitude; a larger one when the "
    "measurement did not move.",
    "identifying": "Give the record more to tell: a longer duration, a larger amplitude, or prbs as the excitation.",
    "tuning": "Keep what runs, or ask for something else: another method, a larger max |S|, a lower crossover.",
    "verifying": "Keep what runs, or ask for something else: another method, a larger max |S|, a lower crossover.",
    "applying": "See whether somebody else changes the gains, and start again.",
    "watching": "The loop got worse with the new gains: ask for a larger phase margin or a smaller max |S|.",
}
"""What to change, by the phase in which an autotuning failed."""
UNMET = {
    "frequency": "Lower the crossover, ask for a smaller phase margin, or choose the method time.",
    "time": "Allow a larger max |S| or a larger control.",
    "rule": "Choose another rule, or the method time.",
}
"""What to change, by the method that did not meet what was asked for."""


def plain(value: float) -> float | None:
    """For JSON, which has no NaN."""
    return value if math.isfinite(value) else None


def gains_told(message: Gains) -> dict[str, float] | None:
    """The five numbers; None where they are not known."""
    numbers = {name: getattr(message, name) for name in GAINS}
    return numbers if all(map(math.isfinite, numbers.values())) else None


def measures_told(message: LoopMeasures) -> dict[str, Any]:
    """What a loop is worth; None for a measure that it does not have."""
    return {"stable": message.stable, **{name: plain(getattr(message, name)) for name in MEASURES}}


def model_told(message: IdentifiedModel) -> dict[str, Any] | None:
    """A learnt process; None where there is none."""
    if not message.process:
        return None
    return {"name": message.template_name, "process": message.process, "fit": plain(message.fit_pct),
            "white": message.white}  # fmt: skip


def proposal_told(message: Proposal) -> dict[str, Any]:
    """Gains that one method found."""
    numbers = ("worst_ms", "setpoint_iae", "load_iae", "noise_gain")
    more = {name: plain(getattr(message.two_degrees, name)) for name in TWO_DEGREES}
    return {"name": message.name, "gains": gains_told(message.gains), "two_degrees": more,
            "achieved": measures_told(message.achieved),
            **{name: plain(getattr(message, name)) for name in (*numbers, *PACE, DEADBAND)},
            "accepted": message.accepted, "message": message.message}  # fmt: skip


def autotune_told(result: Autotune.Result, phase: str) -> dict[str, Any]:
    """An autotuning; ``phase`` is the one in which it ended."""
    return {
        "success": result.success, "message": result.message, "applied": result.applied,
        "rolled_back": result.rolled_back, "model": model_told(result.model),
        "models": [model_told(one) for one in result.models],
        "proposals": [proposal_told(one) for one in result.proposals], "gains": gains_told(result.gains),
        "previous": gains_told(result.previous_gains), "achieved": measures_told(result.achieved),
        "worst_ms": plain(result.worst_ms), "elapsed": plain(result.elapsed), "phase": phase,
        "advice": "" if result.success else ADVICE.get(phase, ADVICE[""]),
    }  # fmt: skip


def tuning_told(result: TuningResult) -> dict[str, Any]:
    """What the tuner publishes of a tuning."""
    return {
        "stamp": result.header.stamp.sec + result.header.stamp.nanosec * 1e-9,
        "method": result.method, "process": result.process, "message": result.message, "unmet": list(result.unmet),
        "success": result.success, "applied": result.applied, "elapsed": plain(result.elapsed),
        "gains": {name: plain(getattr(result.gains, name)) for name in GAINS}, "stable": result.achieved.stable,
        "achieved": measures_told(result.achieved),
        "advice": "" if result.success else UNMET.get(result.method, UNMET["time"]),
    }  # fmt: skip
