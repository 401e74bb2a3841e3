"""Days of random plants whose loads wander: how often gains from one are accepted, and what they are worth.

    python -m tests.core.design.identification.day_campaign [--days 40] [--seed 0]

On each day gains are asked for as `fopid tune time --record` does, and judged on the plant itself: max |S| behind the
hold, by its frequency response.
"""

from __future__ import annotations

import argparse
import math
import time

import numpy as np

from fopid_core.design.recorded_tuning import tune_recorded

from .days import Day

WRONG = 2.5
"""max |S| of gains on the plant itself that are called wrong; they were asked to keep 2.2 on all that is possible."""
KINDS = ("plain", "play", "sticks", "sine", "hops", "lively", "slow")


def drawn(rng: np.random.Generator) -> tuple[str, Day]:
    """A kind and a day."""
    lag, kind = 10.0 ** rng.uniform(1.7, 2.8), str(rng.choice(KINDS))
    lags = lag, lag * rng.uniform(0.05, 0.8)
    h = float(max(round(lag / rng.uniform(10.0, 40.0)), 1))
    gain = float(rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-0.3, 0.7))
    size = rng.uniform(0.5, 4.0)
    day = Day(
        gain, lags, round(lag * 10.0 ** rng.uniform(-1.2, 0.1) / h), h, int(rng.integers(2000, 7500)),
        walk=10.0 ** rng.uniform(-2.8, -0.5) / math.sqrt(lag), noise=10.0 ** rng.uniform(-2.3, -1.0),
        moves=tuple((size * rng.choice([-1.0, 1.0], rng.integers(0, 5))).tolist()), play=0.5 * (kind == "play"),
        sticks=1.0 * (kind == "sticks"), sine=3.0 * (kind == "sine"), hops=2.0 * (kind == "hops"),
        strength=rng.uniform(0.15, 0.7) * (2.0 if kind == "lively" else 1.0),
        rate=rng.uniform(1.0, 4.0) * size / (abs(gain) * lag) if kind == "slow" else math.inf,
    )  # fmt: skip
    return kind, day


def main() -> None:
    """One line a day, and how many were accepted and wrong."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--days", type=int, default=40)
    arguments.add_argument("--seed", type=int, default=0)
    asked = arguments.parse_args()
    accepted = wrong = 0
    for seed in range(asked.seed, asked.seed + asked.days):
        rng, begun = np.random.default_rng(seed), time.perf_counter()
        kind, day = drawn(rng)
        found = tune_recorded(day.record(seed), "time")
        design = found.tuned.tuning if found.success and found.tuned else None
        told = found.message
        if design is not None and design.controller is not None:
            peak = day.peak(design.controller, design.filter)
            accepted, wrong = accepted + 1, wrong + (peak > WRONG)
            told = f"max |S| {peak:.3g}{' WRONG' * (peak > WRONG)}: {told}"
        print(f"{seed:4} {kind:7} {time.perf_counter() - begun:5.1f} s  {told[:140]}", flush=True)
    print(f"{accepted} of {asked.days} accepted, {wrong} of these wrong")


if __name__ == "__main__":
    main()
