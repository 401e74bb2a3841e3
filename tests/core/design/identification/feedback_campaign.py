"""Records of loops that nothing moved from outside: how many are learnt from all the same, and how many wrongly.

    python -m tests.core.design.identification.feedback_campaign [--records 30] [--seed 0] [--gains] [--tell]

Random processes as in the campaign of the frequency response, under random PI, PID and FOPID controllers that hold
them. The first kinds show a constant setpoint: the tail of a transient, or disturbances. The others, the control group,
are moved from outside. Every record is told as it was, and with the faults of real ones. A model is wrong where it is
off by more than 30 % about the crossover that it promises, by the textbook's state space behind a hold; with `--gains`
gains are asked for as `fopid tune frequency --record` does, and wrong where max |S| of the true loop exceeds 2.5.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from fopid_core.design.identification.identified_model import IdentifiedModel
from fopid_core.design.identification.identify import identify
from fopid_core.design.identification.record import Record
from fopid_core.design.recorded_tuning import tune_recorded
from fopid_core.model.fopid import Fopid
from fopid_core.runtime.controller import ControllerSettings, FopidController

from .frequency_response_campaign import Sample, prbs, sample
from .load_campaign import WRONG as WRONG_MS
from .load_campaign import judged, load
from .unstable_campaign import Held, holds

AT_REST = ("tail", "noisy_tail", "rest", "load_step", "load_walk", "load_sinusoid", "output_walk", "output_step")
MOVED = ("setpoint", "from_step", "noisy_setpoint", "prbs", "bump", "bump_at_once", "staircase", "ramps", "by_hand")
FAULTS = ("none", "jitter", "lost", "every_third", "quantised", "rounded", "late", "early", "limited", "stale")
NOISE = {"noisy_tail": (-4.0, -1.5), "rest": (-2.5, -1.5), "noisy_setpoint": (-2.0, -1.3)}
"""Exponents of the noise as a share of the size, at random between these; of other kinds three in ten have none."""
WRONG = 0.3
PLACES = np.array([0.5, 0.7, 1.0, 1.4])
"""Of the crossover that the model promises: there a model is judged."""


@cache
def loop(seed: int) -> tuple[Sample, ControllerSettings, int]:
    """A process, the controller that holds it, and how many samples its time has."""
    rng = np.random.default_rng(seed)
    process = sample(rng)
    each = int(rng.integers(15, 60))
    h = process.lag / each
    gain = process.numerator[-1] / (process.denominator[-2] if process.integrates else process.denominator[-1])
    while True:
        kp, ki = (0.3, 0.03) if process.integrates else (0.3, 0.4)
        kp *= 10.0 ** rng.uniform(-0.3, 0.3) / gain / (process.lag if process.integrates else 1.0)
        ki *= 10.0 ** rng.uniform(-0.3, 0.2) / (gain * process.lag ** (2 if process.integrates else 1))
        kind = rng.choice(["pi", "pid", "fopid"])
        kd = 0.0 if kind == "pi" else abs(kp) * process.lag * rng.uniform(0.02, 0.2) * np.sign(kp)
        lam, mu = (rng.uniform(0.75, 1.1), rng.uniform(0.6, 0.95)) if kind == "fopid" else (1.0, 1.0)
        gains = Fopid(kp, ki, kd, lam, mu)
        if holds(process, gains, h):
            break
    more = {}
    if kind != "pi" and rng.uniform() < 0.5:
        more["derivative_filter_time"] = float(kd / kp / rng.uniform(3.0, 10.0))
    if rng.uniform() < 0.3:
        more |= {"measurement_filter_order": 1, "measurement_filter_time": float(process.lag * rng.uniform(0.01, 0.05))}
    if rng.uniform() < 0.4:
        more |= {"setpoint_weight": float(rng.uniform(0.0, 1.0)), "derivative_setpoint_weight": 0.0}
    return process, ControllerSettings(gains, sample_time=h, **more), each


def digits(values: np.ndarray, count: int) -> np.ndarray:
    """As a table with so many digits tells it."""
    return np.array([float(f"{value:.{count}g}") for value in values])


@dataclass
class Moves:
    """What moves a loop, shape (n,) each; ``by_hand`` is NaN in automatic mode."""

    setpoint: np.ndarray
    load: np.ndarray
    output: np.ndarray
    added: np.ndarray
    by_hand: np.ndarray


def moves(kind: str, before: int, length: int, size: float, process: Sample, rng: np.random.Generator) -> Moves:
    """From rest; what is recorded begins after ``before`` samples."""
    n = before + length
    made = Moves(*(np.zeros(n) for _ in range(4)), np.full(n, np.nan))
    unit = size / abs(process.numerator[-1] / (process.denominator[-1] or process.denominator[-2]))
    shape = kind.rpartition("_")[2]
    if kind in ("tail", "noisy_tail", "from_step"):
        made.setpoint[kind != "from_step" :] = size
    elif kind.endswith("setpoint"):
        k, waits = np.arange(n), before + length // 8
        made.setpoint[:] = size * ((k - waits) // (length // 4) % 2 == 0) * (k > waits)
    elif kind.startswith(("load", "output")):
        walk = shape == "walk"
        drawn = np.cumsum(rng.standard_normal(length)) / math.sqrt(length) if walk else load(shape, length, rng)
        (made.load if kind.startswith("load") else made.output)[before:] = drawn * (
            unit if kind.startswith("load") else size
        )
    elif kind == "prbs":
        made.added[before:] = prbs(length, 32, int(rng.integers(1000))) * unit * 0.3
    elif kind != "rest":
        made.by_hand[:before] = 0.0
        made.by_hand[before:] = unit * hand(kind, length) * (0.3 / process.lag if process.integrates else 1.0)
        if kind == "by_hand":
            made.by_hand[before + 3 * (length // 5) :] = np.nan
    return made


def hand(kind: str, length: int) -> np.ndarray:
    """Moves of the control in manual mode."""
    k, settle = np.arange(length), length // 5
    if kind == "ramps":
        return np.interp(k, settle * np.arange(5), [0.0, 0.0, 1.0, 1.0, 0.3])
    if kind == "staircase":
        return np.minimum(k // settle, 3) / 2.0
    if kind == "bump_at_once":
        return np.ones(length)
    return (k >= settle) - (0.6 if kind == "by_hand" else 0.0) * (k >= 2 * settle)


def signals(kind: str, fault: str, seed: int, offset: float) -> tuple[Record, Sample]:
    """A run from rest at an offset of the measurement, and the part of it that is recorded, without faults of time."""
    process, settings, each = loop(seed)
    rng = np.random.default_rng([seed, (AT_REST + MOVED).index(kind)])
    h, gain = settings.sample_time, process.numerator[-1] / (process.denominator[-1] or process.denominator[-2])
    runs_out = kind in ("tail", "noisy_tail", "rest")
    before = round(each * rng.uniform(1.0, 40.0)) if kind in AT_REST else each
    length = min(max(round(each * rng.uniform(*((3.0, 30.0) if runs_out else (10.0, 40.0)))), 60), 2500)
    before = 0 if kind == "from_step" else before
    noise = 10.0 ** rng.uniform(*NOISE.get(kind, (-4.0, -2.0)))
    if kind == "tail" or (kind not in NOISE and rng.uniform() > 0.7):
        noise = 0.0
    size = float(rng.uniform(0.5, 2.0) * rng.choice([-1.0, 1.0]))
    wanted = moves(kind, before, length, size, process, rng)
    if fault == "limited":
        most = 1.1 * abs(size / gain) * (0.3 / process.lag if process.integrates else 1.0)
        settings = replace(settings, control_min=-most, control_max=most)
    n = before + length
    controller, running, control, measured = FopidController(settings), Held(process, h), np.empty(n), np.empty(n)
    errors = abs(size) * noise * rng.standard_normal(n) + wanted.output
    step = abs(size) / 1024.0
    for k in range(n):
        value = running.measurement + errors[k]
        measured[k] = round(value / step) * step if fault == "quantised" else value
        controller.set_mode("auto" if math.isnan(wanted.by_hand[k]) else "manual")
        manual = float(np.nan_to_num(wanted.by_hand[k]))
        control[k] = controller.step(wanted.setpoint[k], measured[k], feedforward=wanted.added[k], manual=manual)
        running.step(control[k] + wanted.load[k])
    if fault == "quantised" and np.ptp(control):
        control = np.round(control / np.ptp(control) * 1024.0) * np.ptp(control) / 1024.0
    part = slice(before, n)
    record = Record(h * np.arange(length), control[part], measured[part] + offset, wanted.setpoint[part] + offset)
    return record, process


def made(kind: str, fault: str, seed: int) -> tuple[Record, Sample]:
    """One record, with its process."""
    rng = np.random.default_rng([seed, 7])
    record, process = signals(kind, fault, seed, float(rng.choice([0.0, 20.0])))
    n, h = record.time.size, record.sample_time
    setpoint = record.setpoint if rng.uniform() < 0.5 else None
    time, u, y, keep = record.time, record.control, record.measurement, np.ones(n, dtype=bool)
    if fault == "jitter":
        time = time + h * np.clip(rng.normal(0.0, rng.uniform(0.002, 0.1), n), -0.3, 0.3)
    elif fault == "lost":
        keep = rng.uniform(size=n) > 10.0 ** rng.uniform(-2.0, -1.0)
    elif fault == "every_third":
        keep = np.arange(n) % int(rng.integers(2, 6)) == 0
    elif fault == "rounded":
        u, y = digits(u, 4), digits(y, 4)
    elif fault == "late":  # the control is told a tick late
        u = np.append(u[0], u[:-1])
    elif fault == "early":
        u = np.append(u[1:], u[-1])
    elif fault == "stale":  # messages lost: of one of the two signals the last value stands
        lost = np.flatnonzero(rng.uniform(size=n) < 10.0 ** rng.uniform(-2.3, -1.0))
        u, y = u.copy(), y.copy()
        stale = u if rng.uniform() < 0.5 else y
        for k in lost[lost > 0]:
            stale[k] = stale[k - 1]
    if keep.sum() < 30:
        keep[:] = True
    return Record(time[keep], u[keep], y[keep], None if setpoint is None else setpoint[keep]), process


def error(process: Sample, best: IdentifiedModel) -> float:
    """The largest about the crossover that a model promises, as a share of the truth."""
    s = 1j * best.crossover * PLACES
    true = np.polyval(process.numerator, s) / np.polyval(process.denominator, s) * np.exp(-process.delay * s)
    return float(np.abs(best.process(s) / true - 1.0).max())


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--records", type=int, default=30, help="of each kind with each fault")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", default=",".join(AT_REST + MOVED))
    parser.add_argument("--faults", default=",".join(FAULTS))
    parser.add_argument("--gains", action="store_true", help="judge gains that are tuned, not models")
    parser.add_argument("--tell", action="store_true", help="a line for each record")
    asked = parser.parse_args()
    print("| record | fault | records | learnt | wrong | worst |\n| --- | --- | ---: | ---: | ---: | ---: |")
    total = Counter()
    for kind in asked.kinds.split(","):
        group = "at rest" if kind in AT_REST else "moved"
        for fault in asked.faults.split(","):
            worst, counts = 0.0, Counter()
            for seed in range(asked.seed, asked.seed + asked.records):
                record, process = made(kind, fault, seed)
                if asked.gains:
                    tuned = tune_recorded(record, "frequency")
                    success, told = tuned.success, tuned.message
                    off = judged(tuned, process, record.sample_time) if success else 0.0
                    wrong = off > WRONG_MS
                else:
                    found = identify(record)
                    success, told = found.success, found.message
                    off = error(process, found.best) if success else 0.0
                    wrong = off > WRONG
                counts["learnt"] += success
                counts["wrong"] += success and wrong
                worst = max(worst, off)
                if asked.tell:
                    verdict = ("WRONG" if wrong else "yes") if success else "no"
                    print(f"{kind} {fault} {seed} {verdict} {off:.3g} {told}", flush=True)
            row = f"| {kind} | {fault} | {asked.records} | {counts['learnt']} | {counts['wrong']} | {worst:.3g} |"
            print(row, flush=True)
            for name in ("learnt", "wrong"):
                total[group, name] += counts[name]
            total[group, "records"] += asked.records
    for group in ("at rest", "moved"):
        records, learnt, wrong = (total[group, name] for name in ("records", "learnt", "wrong"))
        print(f"{group}: {records} records, {learnt} learnt, {wrong} wrong")


if __name__ == "__main__":
    main()
