"""How far replays may be believed: random plants, also such as no model here can be, against the day lived again.

``python -m tests.core.study.replay_campaign FILE [COUNT] [FIRST] [PLANTS] [LOST]`` appends a line of JSON for each
plant, and prints what they come to. PLANTS: foreign, or strange. LOST: the share of the recorded day's samples that are
left out. The other day has the same setpoints, load, noise and plant, and the gains that were replayed.
"""

from __future__ import annotations

import json
import math
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fopid_core.design.identification.record import Record
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process
from fopid_core.runtime.controller import ControllerSettings, FopidController
from fopid_core.runtime.plant import Plant, PlantSettings
from fopid_core.study.replay import figures, replay

KINDS = ("linear", "saturation", "stiction", "level")
STRANGE = ("positioner", "ramp", "rate", "oscillating")
SAMPLES, RUN_ON = 400, 400


class Foreign:
    """A random plant with a lag, a second one, a delay and one of the flaws that real ones have."""

    def __init__(self, seed: int) -> None:
        random = np.random.default_rng([seed, 17])
        self.kind = KINDS[seed % len(KINDS)]
        self.gain = float(10 ** random.uniform(-0.5, 0.5))
        lag = float(10 ** random.uniform(-0.5, 0.5))
        second, delay = lag * random.uniform(0.0, 0.6), lag * random.uniform(0.02, 0.8)
        self.delay = float(delay)
        self.sample_time = h = (lag + delay) / 15.0
        text = f"{self.gain}/(({lag}*s+1)*({second}*s+1))*exp(-{delay}*s)"
        self._settings = PlantSettings(Process.parse(text), h, delay_model="exact")
        closing = max(delay, 0.1 * lag) * random.uniform(2.0, 5.0)
        kp = (lag + second / 2) / (self.gain * (closing + delay))
        self.running = Fopid(kp, kp / (lag + second / 2))
        # From half as lively as what runs to what rules would call bold, or worse.
        more = random.uniform(0.5, 2.5)
        self.wanted = Fopid(more * kp, more * self.running.ki, kd=float(random.choice([0.0, 0.3])) * kp * delay)
        n = SAMPLES + RUN_ON
        levels = random.uniform(-1.0, 1.0, 5)
        starts = [0, *sorted(random.choice(np.arange(20, SAMPLES - 60), 4, replace=False))]
        self.setpoint = np.repeat(levels, np.diff([*starts, n])) * (np.arange(n) >= starts[1])
        self.noise = 0.01 * random.uniform(0.1, 1.0) * random.standard_normal(n)
        self.load = np.where(np.arange(n) >= random.integers(100, 350), random.uniform(-0.1, 0.1) / self.gain, 0.0)
        self.limit = 2.0 / self.gain
        self.stick = 0.03 / self.gain * float(random.uniform(0.3, 1.0))
        self.bend = float(random.uniform(-0.3, 0.3))

    def run(self, gains: Fopid, samples: int, first: float | None = None) -> Record:
        """The day with these gains, from a first control on if given, as a change of gains goes on from one."""
        controller = FopidController(ControllerSettings(gains, self.sample_time))
        plant = Plant(self._settings)
        stem, rows = 0.0, []
        for k in range(samples):
            output = plant.measurement
            if self.kind == "level":
                output += 0.5 * self.bend * output * output
            measured = output + self.noise[k]
            by_hand = first is not None and k == 0
            controller.set_mode("manual" if by_hand else "auto")
            control = controller.step(float(self.setpoint[k]), float(measured), manual=first or 0.0)
            rows.append((k * self.sample_time, control, measured, self.setpoint[k]))
            stem = self._actuator(control, stem)
            plant.step(stem, float(self.load[k]))
            if not abs(measured) < 1e6:
                break
        return Record(*np.array(rows).T)

    def _actuator(self, control: float, stem: float) -> float:
        if self.kind == "saturation":
            return min(max(control, -self.limit), self.limit)
        if self.kind == "stiction":
            return control if abs(control - stem) > self.stick else stem
        return control


class Strange(Foreign):
    """A random plant with what is not looked for: a positioner, a ramp of the load, a slow actuator, or ringing."""

    def __init__(self, seed: int) -> None:
        super().__init__(len(KINDS) * seed)
        self.kind = STRANGE[seed % len(STRANGE)]
        random = np.random.default_rng([seed, 99])
        ticks = np.arange(SAMPLES + RUN_ON)
        if self.kind == "ramp":
            start, length = int(random.integers(50, 250)), int(random.integers(100, 300))
            size = random.uniform(-0.2, 0.2) / self.gain
            self.load = self.load + size * np.clip((ticks - start) / length, 0.0, 1.0)
        self.stick = 0.03 / self.gain * float(random.uniform(0.3, 1.0))
        self._speed = float(random.uniform(0.02, 0.15)) / self.gain
        self._rate = float(random.uniform(0.03, 0.3)) / self.gain
        self._moving = False
        if self.kind == "oscillating":
            self._ring(random)

    def _ring(self, random: np.random.Generator) -> None:
        damping, turn = float(random.uniform(0.25, 0.7)), float(10 ** random.uniform(-0.5, 0.5))
        self.delay = delay = float(random.uniform(0.05, 0.6)) * turn
        self.sample_time = (2.0 * damping * turn + turn + delay) / 15.0
        text = f"{self.gain}/({turn**2}*s^2+{2.0 * damping * turn}*s+1)*exp(-{delay}*s)"
        self._settings = PlantSettings(Process.parse(text), self.sample_time, delay_model="exact")
        ki = random.uniform(0.12, 0.3) / (self.gain * (delay + 2.0 * damping * turn))
        kp = ki * 2.0 * damping * turn * random.uniform(0.2, 0.6)
        more = random.uniform(0.5, 2.5)
        self.running, self.wanted = Fopid(kp, ki), Fopid(more * kp, more * ki)

    def run(self, gains: Fopid, samples: int, first: float | None = None) -> Record:
        """The day with these gains, from a stem at rest on."""
        self._moving = False
        return super().run(gains, samples, first)

    def _actuator(self, control: float, stem: float) -> float:
        away = control - stem
        if self.kind == "rate":
            return stem + min(max(away, -self._rate), self._rate)
        if self.kind != "positioner":
            return control
        # It runs from a dead band on, as fast as it can, until a fifth of that is left.
        self._moving = abs(away) > self.stick * (0.2 if self._moving else 1.0)
        return stem + math.copysign(min(self._speed, abs(away)), away) if self._moving else stem


PLANTS = {"foreign": Foreign, "strange": Strange}


def without(record: Record, share: float, seed: int) -> Record:
    """A record with a share of its samples left out, never the first or the last."""
    there = np.random.default_rng(seed).random(record.time.size) > share
    there[[0, -1]] = True
    assert record.setpoint is not None
    return Record(record.time[there], record.control[there], record.measurement[there], record.setpoint[there])


def lived(seed: int, plants: str = "foreign", lost: float = 0.0) -> dict[str, Any]:
    """One plant: whether its gains were accepted, and what became of them."""
    plant = PLANTS[plants](seed)
    day = plant.run(plant.running, SAMPLES)
    seen = without(day, lost, seed) if lost else day
    found = replay(seen, ControllerSettings(plant.wanted), seed=seed)
    row: dict[str, Any] = {"seed": seed, "kind": plant.kind, "accepted": found.success, "message": found.message}
    other = plant.run(plant.wanted, SAMPLES + RUN_ON, float(day.control[0]))
    late = np.abs(other.setpoint - other.measurement)[-RUN_ON // 2 :]
    row["holds"] = other.time.size == SAMPLES + RUN_ON and float(late.max()) < 0.3
    if found.measurement is not None and other.time.size >= SAMPLES:
        y, band = other.measurement[:SAMPLES], found.measurement
        row["covered"] = float(np.mean((y >= band.low - 1e-9) & (y <= band.high + 1e-9)))
        row["width"] = float(np.mean(band.high - band.low))
        row["off"] = float(np.abs(y - band.expected).max())
        truth = figures(other.time[:SAMPLES], other.setpoint[:SAMPLES], y, other.control[:SAMPLES])
        row["iae_covered"] = bool(found.after_low.iae <= truth.iae <= found.after_high.iae)
        row["iae_off"] = abs(found.after.iae / truth.iae - 1.0)
    return row


def summary(rows: Sequence[Mapping[str, Any]]) -> str:
    """A line for each kind of plant."""
    told = ["| plant | plants | accepted | of them not held | not accepted, would have held | instants in the band |"
            " IAE in its band | IAE off, median |", "| --- " * 8 + "|"]  # fmt: skip
    for kind in (*dict.fromkeys(row["kind"] for row in rows), "all"):
        some = [row for row in rows if kind in (row["kind"], "all")]
        good = [row for row in some if row["accepted"]]
        shown = [row for row in good if "covered" in row]
        covered, iae_covered, off = (
            [100.0 * float(row[name]) for row in shown] or [math.nan] for name in ("covered", "iae_covered", "iae_off")
        )
        told.append(
            f"| {kind} | {len(some)} | {len(good)} | {sum(not row['holds'] for row in good)} | "
            f"{sum(row['holds'] for row in some if not row['accepted'])} | {np.mean(covered):.1f} +- "
            f"{np.std(covered) / math.sqrt(len(covered)):.1f} % | "
            f"{np.mean(iae_covered):.0f} % | {np.median(off):.1f} % |"
        )
    reasons = Counter(str(row["message"]).split(";")[0][:40] for row in rows if not row["accepted"])
    return "\n".join([*told, "", *(f"{count} x {reason}" for reason, count in reasons.most_common(6))])


def main(file: Path, count: int = 40, first: int = 0, plants: str = "foreign", lost: float = 0.0) -> None:
    """Live them, one after the other."""
    known = [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []
    done = {row["seed"] for row in known}
    for seed in range(first, first + count):
        if seed not in done:
            known.append(lived(seed, plants, lost))
            with file.open("a") as out:
                out.write(json.dumps(known[-1]) + "\n")
    print(summary(known))


if __name__ == "__main__":
    main(Path(sys.argv[1]), *(kind(text) for kind, text in zip((int, int, str, float), sys.argv[2:], strict=False)))
