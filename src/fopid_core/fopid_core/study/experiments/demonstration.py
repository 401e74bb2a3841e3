"""The demonstration's experiment, for any process: step and load by hand, tuned in the time domain, by frequency."""

from __future__ import annotations

import math

from fopid_core.design.defaults import PHASE_MARGIN, natural_crossover
from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import TEST_BENCH, Process, read_process
from fopid_core.model.response import step_response
from fopid_core.model.stability import stability
from fopid_core.runtime.plant import PlantSettings
from fopid_core.study.experiments.experiment import Experiment, Phase
from fopid_core.study.experiments.tune_call import TuneCall

SAMPLES_PER_PHASE = 3000
NOISE_GAIN = 10.0
"""What time-domain tuning may do to noise, in times of what the PI does: as the usual filter of a PID's derivative."""
PATIENCE = 100.0
"""What time-domain tuning may take, beside nodes that run as fast as they can [s]: two cores busy with more need it."""
PAPER_SPECIFICATIONS = {"P1": (80.0, 0.3), "P2": (80.0, 1.0), "P3": (80.0, 0.1), "P4": (80.0, 1.0)}
"""Phase margin [deg] and crossover [rad/s] of the paper's Table 3."""


def demo_experiment(source: str, trigger: str = "lockstep") -> Experiment:
    """Step and load with a PI by hand, tuned in the time domain with no more control, and a step tuned by frequency.

    Parameters
    ----------
    source : str
        P1 ... P4 (with the specification of the paper's Table 3) or a transfer function in s.
    """
    process = read_process(source)
    PlantSettings(process)  # says what cannot be simulated before anything else is tried
    natural = natural_crossover(process, PHASE_MARGIN)
    degrees, crossover = PAPER_SPECIFICATIONS.get(source.strip(), (0.0, 0.0))  # 0: the tuner chooses
    stretch = _round_up(8.0 / min(crossover or 0.5 * natural, natural) + 5.0 * process.delay)
    sample_time = _round_up(stretch / SAMPLES_PER_PHASE)
    gains = starting_gains(process, natural)
    dc = process.steady_state_gain
    load = -0.3 / abs(dc) if math.isfinite(dc) and dc != 0.0 else -0.05
    frequency = TuneCall("frequency", phase_margin_deg=degrees, crossover=crossover)
    in_time = TuneCall(
        "time", index="iae", input="both", structure="fopid", filter_order=2, ms_max=1.6,
        u_max=_control_peak(Loop(process, gains), stretch), noise_max=NOISE_GAIN * abs(gains.kp),
        timeout=PATIENCE,
    )  # fmt: skip
    return Experiment(
        process=source.strip() if source.strip() in TEST_BENCH else str(process),
        name="demo",
        sample_time=sample_time,
        trigger=trigger,
        gains=dict(zip(("kp", "ki", "kd", "lam", "mu"), gains.gains, strict=True)),
        plant={"delay_model": "exact"},
        phases=(
            Phase("starting gains", stretch, setpoint=1.0, disturbance=0.0),
            Phase("load disturbance", stretch, disturbance=load),
            Phase("tuned in the time domain", stretch, setpoint=2.0, tune=in_time),
            Phase("load taken away", stretch, disturbance=0.0),
            Phase("tuned by frequency", stretch, setpoint=3.0, tune=frequency),
        ),
    )


def _control_peak(loop: Loop, horizon: float) -> float:
    """Of a unit setpoint step with gains that have no derivative part, and at least a little above what holds it."""
    holding = 1.0 / abs(loop.process.steady_state_gain) if loop.process.steady_state_gain else 0.0
    return float(f"{max(step_response(loop, horizon).control_peak, 1.05 * holding):.3g}")


def starting_gains(process: Process, natural: float) -> Fopid:
    """A plain PI as one guesses it by hand: modest first, then stronger, then with the other sign."""
    size = abs(complex(process(1j * natural)))
    likely = math.copysign(1.0, process.steady_state_gain) if math.isfinite(process.steady_state_gain) else 1.0
    for sign in (likely, -likely):
        for share in (0.3, 0.1, 1.0, 2.0):
            kp = _digits(sign * share / size)
            for weaker in (0.5, 0.1):
                guess = Fopid(kp, ki=_digits(kp * weaker * natural))
                if stability(Loop(process, guess)).stable:
                    return guess
    raise InputError(f"process {process}: no stable PI to start with; allowed: a process that a PI can hold")


def _digits(value: float) -> float:
    return float(f"{value:.2g}")


def _round_up(value: float) -> float:
    """The next round number."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(float(f"{m * power:.6g}") for m in (1, 1.5, 2, 3, 4, 5, 6, 8, 10) if m * power >= value * (1 - 1e-9))
