"""Processes that run away, learnt from the loop that holds them: how often, how well, and whether the gains hold.

    python -m tests.core.design.identification.unstable_campaign [--records 60] [--seed 0]

Random processes of four kinds (`K/(T s-1)`, `K/(T^2 s^2-1)`, `K/(s(T s-1))`, magnetic levitation with a quick lag),
three in four with a delay of up to 0.3 T, random PID controllers that hold them, an experiment in the control or steps
of the setpoint, noise of 0.1 to 3 % of what moves. The oracle is the textbook's state space behind a hold; a run of
that tells whether a controller holds it, and max |S| comes from it on a dense grid.
"""

from __future__ import annotations

import argparse
from collections import Counter

import numpy as np
from scipy.linalg import expm
from scipy.signal import tf2ss

from fopid_core.design.identification.record import Record
from fopid_core.design.recorded_tuning import RecordedTuning, tune_recorded
from fopid_core.model.fopid import Fopid
from fopid_core.model.two_degrees import NO_FILTER, MeasurementFilter
from fopid_core.runtime.controller import ControllerSettings, FopidController

from .frequency_response_campaign import Sample, prbs

KINDS = ("lag", "pendulum", "integrator", "levitation")
RECORDS = ("autotune", "setpoint")


def process_of(kind: str, rng: np.random.Generator) -> Sample:
    """One of a kind, with its time T as ``lag``."""
    time, gain = 10.0 ** rng.uniform(-0.5, 0.5), 10.0 ** rng.uniform(-0.5, 0.7)
    bottom = {
        "lag": [time, -1.0],
        "pendulum": [time**2, 0.0, -1.0],
        "integrator": [time**2, -time, 0.0],
        "levitation": list(np.polymul([time**2, 0.0, -1.0], [time * rng.uniform(0.02, 0.1), 1.0])),
    }[kind]
    most = {"lag": 0.3, "pendulum": 0.1, "integrator": 0.1, "levitation": 0.03}[kind]
    delay = float(time * rng.uniform(0.0, most)) if rng.uniform() < 0.75 else 0.0
    return Sample([gain], bottom, delay, time)


class Held:
    """The state space behind a hold, with a delay; from rest."""

    def __init__(self, process: Sample, h: float) -> None:
        a, b, c, _ = tf2ss(process.numerator, process.denominator)
        self._ticks = int(np.ceil(process.delay / h - 1e-9))
        late = self._ticks * h - process.delay
        size = len(a)

        def over(time: float) -> tuple[np.ndarray, np.ndarray]:
            whole = expm(np.block([[a, b], [np.zeros((1, size + 1))]]) * time)
            return whole[:size, :size], whole[:size, size]

        (self._step, _), (_, first), (over_late, self._new) = over(h), over(h - late), over(late)
        self._old, self._c, self._x = over_late @ first, c[0], np.zeros(size)
        self._sent = [0.0] * (self._ticks + 1)

    @property
    def measurement(self) -> float:
        return float(self._c @ self._x)

    def step(self, control: float) -> None:
        self._sent.append(control)
        newer = self._sent[-self._ticks] if self._ticks else control
        self._x = self._step @ self._x + self._old * self._sent[-1 - self._ticks] + self._new * newer


def run(process: Sample, gains: Fopid, h: float, setpoint: np.ndarray, added: np.ndarray, errors: np.ndarray,
        slow: MeasurementFilter = NO_FILTER) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Control and measurement of the loop."""
    controller = FopidController(ControllerSettings(
        gains, sample_time=h, measurement_filter_order=slow.order, measurement_filter_time=slow.time
    ))  # fmt: skip
    plant, control, measured = Held(process, h), np.zeros(errors.size), np.zeros(errors.size)
    for k in range(errors.size):
        measured[k] = plant.measurement + errors[k]
        control[k] = controller.step(setpoint[k], measured[k]) + added[k]
        if abs(measured[k]) > 1e4:
            measured[k:] = np.inf
            break
        plant.step(control[k])
    return control, measured


def holds(process: Sample, gains: Fopid, h: float, slow: MeasurementFilter = NO_FILTER, left: float = 0.1) -> bool:
    """Whether the loop comes to rest after a pulse of the control, to that share of its answer, by running it."""
    samples = round(60.0 * process.lag / h)
    still = np.zeros(samples)
    _, measured = run(process, gains, h, still, (np.arange(samples) < 5).astype(float), still, slow)
    with np.errstate(invalid="ignore"):
        return bool(np.abs(measured[-samples // 5 :]).max() < left * np.abs(measured).max())


def controller_of(process: Sample, kind: str, h: float, rng: np.random.Generator) -> Fopid | None:
    """Random gains that hold it."""
    gain, time = process.numerator[0], process.lag
    for _ in range(60):
        kp = 10.0 ** rng.uniform(0.1, 1.0) / gain
        kd = 0.0 if kind == "lag" and rng.uniform() < 0.7 else kp * time * 10.0 ** rng.uniform(-0.6, 0.3)
        if kind == "integrator":
            kp, kd = 0.3 * kp, 10.0 ** rng.uniform(0.1, 0.7) * time / gain
        ki = kp / time * 10.0 ** rng.uniform(-1.5, -0.3)
        if holds(process, Fopid(kp, ki, kd), h):
            return Fopid(kp, ki, kd)
    return None


def made(kind: str, moved: str, seed: int) -> tuple[Record, Sample, Fopid] | None:
    """One record, with its process and the gains it was made with; None where none were found."""
    rng = np.random.default_rng(seed)
    process = process_of(kind, rng)
    h = process.lag / float(rng.uniform(15.0, 60.0))
    gains = controller_of(process, kind, h, rng)
    if gains is None:
        return None
    samples = int(rng.integers(700, 2000))
    bits = np.concatenate([np.zeros(samples // 10), prbs(samples, int(rng.integers(25, 80)), seed)])[:samples]
    square = (np.arange(samples) // (samples // 8) % 2).astype(float)
    still = np.zeros(samples)
    signals = (still, bits) if moved == "autotune" else (square, still)
    _, clean = run(process, gains, h, *signals, still)
    errors = float(np.std(clean)) * 10.0 ** rng.uniform(-3.0, -1.5) * rng.standard_normal(samples)
    control, measured = run(process, gains, h, *signals, errors)
    added = bits if moved == "autotune" else None
    return Record(h * np.arange(samples), control, measured, signals[0], excitation=added), process, gains


def worst_sensitivity(process: Sample, gains: Fopid, slow: MeasurementFilter, h: float) -> float:
    """max |S| of the sampled loop; infinite where a run of it does not come to rest."""
    if not holds(process, gains, h, slow):
        return float("inf")
    w = np.geomspace(1e-3 / process.lag, 0.98 * np.pi / h, 3000)
    return float(np.max(1.0 / np.abs(1.0 + gains(1j * w) * slow(1j * w) * process.held(h, w))))


def covered(found: RecordedTuning, process: Sample) -> tuple[float, float]:
    """The error of the model where a controller would work, in deviations, and as a share of the truth."""
    best = found.identified.best
    assert best is not None
    s = 1j * best.crossover
    true = np.polyval(process.numerator, s) / np.polyval(process.denominator, s) * np.exp(-process.delay * s)
    error = float(abs(complex(best.process(s)) / true - 1.0))
    return error / max(best.deviation, 1e-300), error


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--records", type=int, default=30, help="of each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--method", default="frequency")
    parser.add_argument("--tell", action="store_true", help="a line for each record")
    asked = parser.parse_args()
    print("| process | record | records | learnt | within 2 sd | median error % | gains | unstable | Ms above 2.5 |")
    print("| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: |")
    for kind in asked.kinds.split(","):
        for moved in RECORDS:
            counts, errors = Counter[str](), []
            for seed in range(asked.seed, asked.seed + asked.records):
                found = made(kind, moved, seed)
                if found is None:
                    continue
                signals, process, gains = found
                counts["records"] += 1
                tuned = tune_recorded(signals, asked.method)
                told = f"{kind} {moved} {seed} {process.text} {gains}: {tuned.message}"
                if tuned.identified.success:
                    counts["learnt"] += 1
                    far, error = covered(tuned, process)
                    counts["within"] += far <= 2.0
                    errors.append(error)
                    told = f"{far:.2f} deviations, {100 * error:.2g} %; {told}"
                design = tuned.tuned.tuning if tuned.success and tuned.tuned else None
                if design is not None and design.controller is not None:
                    ms = worst_sensitivity(process, design.controller, design.filter, signals.sample_time)
                    counts["gains"] += 1
                    counts["unstable"] += np.isinf(ms)
                    counts["beyond"] += ms > 2.5
                    told = f"Ms {ms:.3g}, {told}"
                if asked.tell:
                    print(told, flush=True)
            middle = 100.0 * float(np.median(errors)) if errors else float("nan")
            row = [counts["records"], counts["learnt"], counts["within"], f"{middle:.2g}", counts["gains"],
                   counts["unstable"], counts["beyond"]]  # fmt: skip
            print(f"| {kind} | {moved} | {' | '.join(map(str, row))} |", flush=True)


if __name__ == "__main__":
    main()
