"""Experiments on the gallery, again and again: ``python examples/plants/repetitions.py [PLANT ...] [--count 50]``.

Each with noise of its own and from a set-point of its own, up to one move away from the usual one; nothing is tuned.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable

import numpy as np
from foreign_plants.gallery import GALLERY, known_plants
from virtual_loop import TooLongError, VirtualLoop

from fopid_core.errors import InputError
from fopid_ros.tuner.learning.closed_loop_experiment import ClosedLoopExperiment, ExperimentSettings
from fopid_ros.tuner.learning.loop_baseline import LoopBaseline
from fopid_ros.tuner.learning.running_controller import read_running_controller

BAND = 1.2
"""The allowed deviation is the measurement's, which is noisy; the true output may go so many times as far."""
HEAD = (
    "| plant | experiments | came to their end | beyond the allowed deviation | unsafe |\n"
    "| --- | ---: | ---: | ---: | ---: |"
)


def experiment(name: str, seed: int) -> tuple[bool, bool, bool]:
    """Whether an experiment came to its end, went beyond what it was allowed, and left what is safe."""
    exhibit = GALLERY[name]
    loop = VirtualLoop(exhibit, seed, longest=100.0 * exhibit.horizon)
    loop.setpoint += exhibit.move * float(np.random.default_rng(seed).uniform(-1.0, 1.0))
    loop.run(exhibit.horizon)
    first, ended, allowed = len(loop.trace.true), "", 0.0
    try:
        made = ClosedLoopExperiment(loop, loop, LoopBaseline(read_running_controller(loop)), ExperimentSettings())
        made.measure()
        allowed, first = made.loop.deviation_max, len(loop.trace.true)
        ended = made.excite()
    except (InputError, TooLongError) as error:  # refused: it was not begun
        ended = str(error)
    true, (low, high) = np.array(loop.trace.true), exhibit.unsafe
    far = float(np.max(np.abs(true[first:] - loop.setpoint), initial=0.0)) > BAND * allowed
    return not ended, far and allowed > 0.0, not bool(low < true.min() and true.max() < high)


def line(name: str, seeds: Iterable[int]) -> str:
    """Of the table."""
    seen = np.array([experiment(name, seed) for seed in seeds])
    return f"| {name} | {len(seen)} | " + " | ".join(str(count) for count in seen.sum(axis=0)) + " |"


def main() -> int:
    """Repeat and tell."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("plants", nargs="*", default=known_plants())
    parser.add_argument("--count", type=int, default=50)
    given = parser.parse_args()
    print(HEAD)
    for name in given.plants:
        print(line(name, range(given.count)), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
