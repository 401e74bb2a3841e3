"""Loads that come during a record: how often gains from it are accepted, and how many of those are wrong.

    python -m tests.core.design.identification.load_campaign [--records 40] [--seed 0] [--kinds pulse,ramp]

Processes, noise and controllers as in the campaign of the frequency response; the load acts at the control from a
random instant on, between a fifth and all of what the experiment moves, or three times that (``large``). On each record
gains are asked for as `fopid tune frequency --record` does, and judged on the true process: max |S| behind the hold, by
the textbook's state space on a dense grid; a run of that tells whether the loop is stable.
"""

from __future__ import annotations

import argparse

import numpy as np

from fopid_core.design.identification.record import Record
from fopid_core.design.recorded_tuning import RecordedTuning, tune_recorded
from fopid_core.model.fopid import Fopid
from fopid_core.model.two_degrees import MeasurementFilter
from fopid_core.runtime.controller import ControllerSettings, FopidController

from .frequency_response_campaign import Sample, prbs, sample
from .recorded import plant
from .unstable_campaign import holds

LOADS = ("none", "step", "pulse", "pulses", "ramp", "slope", "sinusoid")
RECORDS = ("autotune", "setpoint", "prbs")
CALMED = 0.5
"""Of the largest answer to a pulse, what a stable loop leaves at most in the last fifth of a run."""
MS_MAX = 2.2
WRONG = 2.5
"""max |S| of gains on the true process that are called wrong; they were asked to keep 2.2 on all that is possible."""


def load(kind: str, samples: int, rng: np.random.Generator) -> np.ndarray:
    """A load of unit size over so many samples."""
    k, begins = np.arange(samples), int(samples * rng.uniform(0.15, 0.85))
    lasts = int(samples * rng.uniform(0.03, 0.4))
    if kind == "none":
        return np.zeros(samples)
    if kind == "step":
        return (k >= begins).astype(float)
    if kind == "pulse":
        return ((k >= begins) & (k < begins + lasts)).astype(float)
    if kind == "pulses":
        return sum((load("pulse", samples, rng) * rng.choice([-1.0, 1.0]) for _ in range(4)), np.zeros(samples))
    if kind == "ramp":  # from one load to another
        return np.clip((k - begins) / lasts, 0.0, 1.0)
    if kind == "slope":  # to the end of the record
        return np.maximum(k - begins, 0) / (samples - begins)
    turns = 10.0 ** rng.uniform(0.3, 1.8)
    return np.where(k >= begins, np.sin(2.0 * np.pi * turns * (k - begins) / samples), 0.0)


def loop_record(process: Sample, kind: str, felt: np.ndarray, h: float, errors: np.ndarray, seed: int) -> Record:
    """From rest: a calm PI with an experiment or steps of the setpoint, or the control's steps alone."""
    samples = errors.size
    gain = process.numerator[-1] / (process.denominator[-2] if process.integrates else process.denominator[-1])
    if process.integrates:
        gains = Fopid(kp=0.4 / (gain * process.lag), ki=0.04 / (gain * process.lag**2))
    else:
        gains = Fopid(kp=0.2 / gain, ki=0.4 / (gain * process.lag))
    controller = FopidController(ControllerSettings(gains, sample_time=h))
    still, square = np.zeros(samples), (np.arange(samples) // (samples // 6) % 2).astype(float)
    bits = np.concatenate([np.zeros(samples // 33), prbs(samples, 32, seed)])[:samples]
    setpoint = square if kind == "setpoint" else still
    running, control, measured = plant(process.text, h), np.empty(samples), np.empty(samples)
    for k in range(samples):
        measured[k] = running.measurement + errors[k]
        answer = 0.0 if kind == "prbs" else controller.step(setpoint[k], measured[k])
        control[k] = answer + (0.0 if kind == "setpoint" else bits[k])
        running.step(control[k] + felt[k])
    added = bits if kind == "autotune" else None
    return Record(h * np.arange(samples), control, measured, setpoint, excitation=added)


def made(kind: str, disturbed: str, seed: int, *, large: bool = False) -> tuple[Record, Sample]:
    """One record, with its process."""
    rng = np.random.default_rng(seed)
    process = sample(rng)
    samples = int(rng.integers(300, 2500))
    h = process.lag * float(rng.uniform(15.0, 50.0)) / samples
    gain = process.numerator[-1] / (process.denominator[-1] or process.denominator[-2])
    errors = abs(gain) * 10.0 ** rng.uniform(-3.0, -1.5) * rng.standard_normal(samples)
    size = (3.0 if large else 1.0) * rng.uniform(0.2, 1.0) * rng.choice([-1.0, 1.0])
    if kind == "setpoint":
        size *= 0.5 / abs(gain)  # what a step of the setpoint asks of the control
    return loop_record(process, kind, size * load(disturbed, samples, rng), h, errors, seed), process


def true_ms(process: Sample, gains: Fopid, slow: MeasurementFilter, h: float) -> float:
    """max |S| of the sampled loop; infinite where a run of it does not calm down."""
    if not holds(process, gains, h, slow, CALMED):
        return float("inf")
    w = np.geomspace(1e-3 / process.lag, 0.98 * np.pi / h, 3000)
    return float(np.max(1.0 / np.abs(1.0 + gains(1j * w) * slow(1j * w) * process.held(h, w))))


def judged(found: RecordedTuning, process: Sample, h: float) -> float:
    """max |S| of accepted gains on the true process; NaN where there are none."""
    design = found.tuned.tuning if found.success and found.tuned else None
    if design is None or design.controller is None:
        return float("nan")
    return true_ms(process, design.controller, design.filter, h)


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--records", type=int, default=40, help="of each kind with each load")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", default=",".join(LOADS))
    parser.add_argument("--from", dest="records_of", default=",".join(RECORDS))
    parser.add_argument("--large", action="store_true")
    parser.add_argument("--tell", action="store_true", help="a line for each record")
    asked = parser.parse_args()
    print("| record | load | records | accepted | max S above 2.2 | above 2.5 | unstable | worst |")
    print("| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: |")
    for kind in asked.records_of.split(","):
        for disturbed in asked.kinds.split(","):
            found = []
            for seed in range(asked.seed, asked.seed + asked.records):
                signals, process = made(kind, disturbed, seed, large=asked.large)
                tuned = tune_recorded(signals, "frequency")
                found.append(judged(tuned, process, signals.sample_time))
                if asked.tell:
                    print(f"{kind} {disturbed} {seed} {found[-1]:.3g} {process.text}: {tuned.message}", flush=True)
            ms = np.array(found)
            got = ms[~np.isnan(ms)]
            row = [got.size, *(int((got > m).sum()) for m in (MS_MAX, WRONG)), int(np.isinf(got).sum())]
            worst = got.max() if got.size else float("nan")
            print(f"| {kind} | {disturbed} | {ms.size} | {' | '.join(map(str, row))} | {worst:.3g} |", flush=True)


if __name__ == "__main__":
    main()
