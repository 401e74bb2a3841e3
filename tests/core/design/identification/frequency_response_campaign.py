"""How often the true response lies in the regions of `frequency_response`: a table, by kind of record and of noise.

    python -m tests.core.design.identification.frequency_response_campaign [--records 40]

Each record has its own process: P1 to P4 in a quarter of them, else a random one, up to three lags, a resonance, a
zero, a delay of any length, one in six of them integrating. The oracle is the textbook's state space of a process
behind a hold with a delay (Astrom and Wittenmark, Computer-Controlled Systems, 3rd ed., ch. 2.3).
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter, tf2ss

from fopid_core.design.identification.frequency_response import FrequencyResponse, frequency_response
from fopid_core.design.identification.record import Record
from fopid_core.model.fopid import Fopid
from fopid_core.runtime.controller import ControllerSettings, FopidController

from .recorded import plant

BENCH: tuple[tuple[list[float], list[float]], ...] = (
    ([1.0], list(np.poly([-1.0] * 3))),
    ([9.0], list(np.polymul([1.0, 1.0], [1.0, 2.0, 9.0]))),
    ([1.0], list(np.poly([-1.0] * 4))),
    ([1.0], list(np.polymul(np.polymul([1.0, 1.0], [0.2, 1.0]), np.polymul([0.04, 1.0], [0.008, 1.0])))),
)
LONG = (15.0, 50.0)
"""A record lasts so many times what the process takes."""
SAMPLES = (300, 2500)
BRIEF, BRIEFLY = (3.0, 20.0), (120, 300)
"""The same of a record of one step of the setpoint; and how many samples."""


@dataclass(frozen=True)
class Sample:
    """A process: numerator and denominator in falling powers, delay [s], and the time it takes [s]."""

    numerator: list[float]
    denominator: list[float]
    delay: float
    lag: float

    @property
    def text(self) -> str:
        """As fopid reads it."""
        top, bottom = (
            "+".join(f"({c!r})*s^{len(p) - 1 - i}" for i, c in enumerate(map(float, p)))
            for p in (self.numerator, self.denominator)
        )
        return f"({top})/({bottom})*exp(-{self.delay!r}s)" if self.delay else f"({top})/({bottom})"

    @property
    def integrates(self) -> bool:
        """Whether a constant control makes a ramp."""
        return self.denominator[-1] == 0.0

    def held(self, h: float, frequency: np.ndarray) -> np.ndarray:
        """Its response behind a hold, at frequencies [rad/s]."""
        a, b, c, _ = tf2ss(self.numerator, self.denominator)
        ticks = int(np.ceil(self.delay / h - 1e-9))
        late = ticks * h - self.delay  # after the tick's beginning, the new control has acted for so long
        size = len(a)

        def over(time: float) -> tuple[np.ndarray, np.ndarray]:
            whole = expm(np.block([[a, b], [np.zeros((1, size + 1))]]) * time)
            return whole[:size, :size], whole[:size, size:]

        step, _ = over(h)
        _, first = over(h - late)
        over_late, second = over(late)
        z = np.exp(1j * frequency * h)
        # x_(k+1) = step x_k + (what the older control does) u_(k - ticks) + second u_(k - ticks + 1)
        older = over_late @ first
        return np.array(
            [
                (c @ np.linalg.solve(v * np.eye(size) - step, older * v**-ticks + second * v ** (1 - ticks)))[0, 0]
                for v in z
            ]
        )


def sample(rng: np.random.Generator) -> Sample:
    """P1 to P4, or a random process."""
    if rng.uniform() < 0.25:
        numerator, denominator = BENCH[int(rng.integers(4))]
        return Sample(numerator, denominator, 0.0, 3.0)
    lags = 10.0 ** rng.uniform(-1.0, 0.0, int(rng.integers(1, 4)))
    denominator = np.array([1.0])
    for lag in lags:
        denominator = np.polymul(denominator, [lag, 1.0])
    if rng.uniform() < 0.25:
        slow = 10.0 ** rng.uniform(-1.0, 0.0)
        denominator = np.polymul(denominator, [slow**2, 2.0 * rng.uniform(0.2, 0.9) * slow, 1.0])
    if rng.uniform() < 1.0 / 6.0:
        denominator = np.polymul(denominator, [1.0, 0.0])
    numerator = np.array([rng.uniform(0.5, 3.0)])
    if len(denominator) > 2 and rng.uniform() < 0.3:
        numerator = np.polymul(numerator, [rng.uniform(-0.5, 1.0), 1.0])
    delay = float(rng.uniform(0.0, 1.5)) if rng.uniform() < 0.7 else 0.0
    return Sample(list(numerator), list(denominator), delay, float(lags.sum()) + delay + 0.5)


def prbs(samples: int, chips: int, seed: int) -> np.ndarray:
    """The bits of a random telegraph, each held as long."""
    bits = np.random.default_rng(seed).choice([-1.0, 1.0], chips + 1)
    return np.repeat(bits, -(-samples // chips))[:samples]


def noise(kind: str, samples: int, rng: np.random.Generator) -> np.ndarray:
    """Of about unit size."""
    white = rng.standard_normal(samples)
    if kind == "coloured":
        pole = rng.uniform(0.7, 0.97)
        return lfilter([np.sqrt(1.0 - pole**2)], [1.0, -pole], white)
    if kind == "drift":
        return white + 10.0 / np.sqrt(samples) * np.cumsum(rng.standard_normal(samples))
    if kind == "ramp":
        return white + np.linspace(0.0, 20.0, samples)
    return white


def open_loop(process: Sample, control: np.ndarray, h: float, errors: np.ndarray) -> Record:
    """From rest."""
    running, measured = plant(process.text, h), np.empty(control.size)
    for k, value in enumerate(control):
        measured[k] = running.measurement
        running.step(value)
    return Record(h * np.arange(control.size), control, measured + errors)


def closed_loop(
    process: Sample, setpoint: np.ndarray, h: float, errors: np.ndarray, added: Callable[[int], float]
) -> Record:
    """A calm PI around it."""
    gain = process.numerator[-1] / (process.denominator[-2] if process.integrates else process.denominator[-1])
    if process.integrates:
        gains = Fopid(kp=0.4 / (gain * process.lag), ki=0.04 / (gain * process.lag**2))
    else:
        gains = Fopid(kp=0.2 / gain, ki=0.4 / (gain * process.lag))
    controller = FopidController(ControllerSettings(gains, sample_time=h))
    running = plant(process.text, h)
    control, measured = np.empty(setpoint.size), np.empty(setpoint.size)
    for k, wanted in enumerate(setpoint):
        measured[k] = running.measurement + errors[k]
        control[k] = controller.step(wanted, measured[k]) + added(k)
        running.step(control[k])
    return Record(h * np.arange(setpoint.size), control, measured, setpoint)


def record(kind: str, colour: str, seed: int, denser: int = 1) -> tuple[Record, Sample]:
    """One record, with its process; of so many times more samples in the same time."""
    rng = np.random.default_rng(seed)
    process = sample(rng)
    few, lengths = (BRIEFLY, BRIEF) if kind == "brief" else (SAMPLES, LONG)
    samples = denser * int(rng.integers(*few))
    h = process.lag * float(rng.uniform(*lengths)) / samples
    gain = process.numerator[-1] / (process.denominator[-1] or process.denominator[-2])
    level = abs(gain) * 10.0 ** rng.uniform(-2.5, -1.0)
    errors = level * noise(colour, samples, rng)
    still = np.zeros(samples)
    if kind == "prbs":
        return open_loop(process, prbs(samples, int(rng.integers(20, 100)), seed), h, errors), process
    if kind == "step":
        return open_loop(process, (np.arange(samples) >= samples // 5).astype(float), h, errors), process
    if kind == "autotune":
        bits = np.concatenate([np.zeros(samples // 33), prbs(samples, 32, seed)])[:samples]
        return closed_loop(process, still, h, errors, lambda k: float(bits[k])), process
    if kind == "brief":
        step = float(rng.uniform(0.1, 1.0)) * (np.arange(samples) >= samples // 8)
        return closed_loop(process, step, h, errors, lambda _: 0.0), process
    square = (np.arange(samples) // (samples // 6) % 2).astype(float)
    return closed_loop(process, square, h, errors, lambda _: 0.0), process


def judged(found: FrequencyResponse, process: Sample) -> tuple[int, int, int]:
    """How many frequencies there are, how many are known, and at how many of these the truth lies in the region."""
    true = process.held(found.sample_time, found.frequency)[found.known]
    inside = np.abs(true - found.response[found.known]) <= found.radius[found.known]
    return found.frequency.size, int(found.known.sum()), int(inside.sum())


KINDS = ("prbs", "autotune", "setpoint", "step", "brief")
NOISES = ("white", "coloured", "drift", "ramp")


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--records", type=int, default=40, help="of each kind with each noise")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--denser", type=int, default=1, help="so many times more samples in the same time")
    asked = parser.parse_args()
    print("| record | noise | records | known [%] | covered [%] |\n| --- | --- | --- | --- | --- |")
    for kind in KINDS:
        for colour in NOISES:
            counts = np.zeros(3)
            for seed in range(asked.seed, asked.seed + asked.records):
                signals, process = record(kind, colour, seed, asked.denser)
                counts += judged(frequency_response(signals), process)
            known, covered = 100.0 * counts[1] / counts[0], 100.0 * counts[2] / max(counts[1], 1)
            print(f"| {kind} | {colour} | {asked.records} | {known:.0f} | {covered:.1f} |", flush=True)


if __name__ == "__main__":
    main()
