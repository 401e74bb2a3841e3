"""Records of loops with and without a dead band in the actuator: how often one is found, and how often there was none.

    python -m tests.core.design.identification.dead_band_campaign [--records 60] [--seed 0] [--kinds play,none]

Random lags and integrators behind delays, stepped through by the textbook's matrices under a PI and random steps, with
sensors that are white, slow, coarse or hum, and loads that walk or step. Actuators have play or stick, or have other
faults, which must not pass for a dead band: limits, a limited rate, a gain that bends.
"""

from __future__ import annotations

import argparse
from collections import Counter

import numpy as np
from scipy.signal import cont2discrete, tf2ss

from fopid_core.design.identification.identify import identify
from fopid_core.design.identification.record import Record
from fopid_core.errors import InputError

KINDS = ("none", "bend", "limit", "rate", "play", "stick")
NOISES = ("white", "slow", "coarse", "hum", "walk", "load")
NEAR = 0.3
"""A dead band is right when it is off by no more than this share."""


def sensor(kind: str, level: float, count: int, ticks: float, rng: np.random.Generator) -> np.ndarray:
    """What is added to the measurement, shape (n,)."""
    noise = level * rng.standard_normal(count)
    if kind == "slow":
        for k in range(1, count):
            noise[k] = 0.9 * noise[k - 1] + 0.43 * noise[k]
    if kind == "hum":
        noise += 2.0 * level * np.sin(2.0 * np.pi * np.arange(count) / (ticks * rng.uniform(0.2, 2.0)))
    return noise


def made(kind: str, size: float, seed: int) -> Record:
    """The record of a loop; a dead band of ``size`` where steps of 1 at random move the control."""
    rng = np.random.default_rng(seed)
    lags = 10.0 ** rng.uniform(0.5, 1.5, int(rng.integers(1, 4)))
    time, ticks = float(lags.sum()), float(rng.choice([20, 40, 80]))
    h, delay = time / ticks, int(rng.integers(1, int(0.5 * ticks) + 1))
    gain = at_work = 10.0 ** rng.uniform(-1.0, 1.0)
    if rng.random() < 0.3:  # nearly an integrator
        gain, lags[0] = gain * 3e4, 1e4 * time
    den = np.poly1d([1.0])
    for lag in lags:
        den *= np.poly1d([lag, 1.0])
    a, b, c, *_ = cont2discrete(tf2ss([gain], den.coeffs), h)
    count, noise = int(rng.choice([400, 1000, 3000])), str(rng.choice(NOISES))
    hold, level = max(round(ticks * rng.uniform(0.5, 1.5)), 2), at_work * 10.0 ** rng.uniform(-2.3, -0.9)
    added = np.repeat(rng.choice([-1.0, 1.0], count // hold + 1), hold)[:count]
    beside, load = sensor(noise, level, count, ticks, rng), np.zeros(count)
    if noise == "walk":
        load = 0.5 * np.cumsum(rng.standard_normal(count)) / np.sqrt(count)
    if noise == "load":
        load[int(rng.integers(count // 4, count)) :] = rng.uniform(-0.5, 0.5)
    controls, measured, waiting = np.empty(count), np.empty(count), [0.0] * delay
    state, integral, stem, slow = np.zeros((len(a), 1)), 0.0, 0.0, 0.0
    for k in range(count):
        output = (c @ state).item()
        read = output + beside[k] + (0.3 * output**2 / at_work if kind == "bend" else 0.0)
        read = 3.0 * level * round(read / (3.0 * level)) if noise == "coarse" else read
        integral -= 0.3 / at_work / time * h * read
        controls[k], measured[k] = integral - 0.3 / at_work * read + added[k], read
        wanted = min(max(controls[k], -0.9), 0.9) if kind == "limit" else controls[k]
        slow += min(max(wanted - slow, -0.15), 0.15) if kind == "rate" else wanted - slow
        if kind == "play":
            stem = min(max(stem, slow - size), slow + size)
        elif kind != "stick" or abs(slow - stem) > size:
            stem = slow
        waiting.append(stem + load[k])
        state = a @ state + b * waiting.pop(0)
    return Record(h * np.arange(count), controls, measured)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--records", type=int, default=60, help="of each kind")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--tell", action="store_true", help="a line for each that was found")
    asked = parser.parse_args()
    print("| actuator | records | learnt | dead band found | right |\n| --- | ---: | ---: | ---: | ---: |")
    for kind in asked.kinds.split(","):
        counts = Counter[str]()
        for seed in range(asked.seed, asked.seed + asked.records):
            size = 10.0 ** np.random.default_rng([seed, 1]).uniform(-1.5, -0.3) if kind in ("play", "stick") else 0.0
            try:
                found = identify(made(kind, size, seed))
            except (InputError, OverflowError):  # its loop runs away, beyond numbers
                continue
            band, alike = float(found.flaws.dead_band), (found.flaws.slip == 1.0) == (kind == "stick")
            counts["records"] += 1
            counts["learnt"] += found.success
            counts["found"] += band > 0.0
            counts["right"] += band > 0.0 and alike and size > 0.0 and abs(band / size - 1.0) < NEAR
            if asked.tell and band:
                print(f"{kind} {seed} {size:.3g}: {found.message}", flush=True)
        print(
            f"| {kind} | {' | '.join(str(counts[name]) for name in ('records', 'learnt', 'found', 'right'))} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
