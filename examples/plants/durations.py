"""How long experiments on the gallery take: ``python examples/plants/durations.py [PLANT ...] [--seeds 4]``.

In closed-loop time constants: the time in which the true output of the loop with start gains makes 63 % of a step of
the setpoint, sensor noise left out. Last, what it took over what was said first.
"""

from __future__ import annotations

import argparse
import math
import sys
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from foreign_plants.gallery import GALLERY, known_plants
from virtual_loop import TooLongError, VirtualLoop

from fopid_core.design.sufficiency import Sufficiency
from fopid_core.errors import InputError
from fopid_ros.tuner.learning.closed_loop_experiment import ClosedLoopExperiment, ExperimentSettings
from fopid_ros.tuner.learning.loop_baseline import LoopBaseline
from fopid_ros.tuner.learning.running_controller import read_running_controller

REST = 0.3
"""How long the loop runs before, in the plant's horizons."""
SEEDS = tuple(range(11, 27))
"""Of noise, over which the answer to the setpoint's step is averaged."""


def time_constant(name: str) -> float:
    """Of the loop with start gains [s]; infinite where it does not come there within its horizon."""
    exhibit, answers = GALLERY[name], []
    for seed in SEEDS:
        loop = VirtualLoop(exhibit, seed)
        loop.run(REST * exhibit.horizon)
        before, loop.setpoint = loop.setpoint, loop.setpoint + exhibit.move
        _, _, true, _ = loop.trace.part(loop.run(exhibit.horizon))
        answers.append(true - before)
    there = np.mean(answers, axis=0) > 0.632 * exhibit.move
    return exhibit.sample_time * float(np.argmax(there)) if there.any() else math.inf


def duration(name: str, seed: int) -> tuple[float, float]:
    """From the first wait for rest to the end of an experiment, NaN for one that ended early; and what was said [s]."""
    exhibit = GALLERY[name]
    loop = VirtualLoop(exhibit, seed, longest=100.0 * exhibit.horizon)
    loop.run(REST * exhibit.horizon)
    began = loop.time
    made = ClosedLoopExperiment(loop, loop, LoopBaseline(read_running_controller(loop)), ExperimentSettings())
    said = made.length.experiment
    try:
        made.measure()
        since = loop.history.whole_since = loop.history.newest_time("control")
        sufficiency = Sufficiency("all", made.loop.unrest, exhibit.sample_time)
        ended = made.excite(lambda: sufficiency.is_over(loop.history.record(since), made.may_widen, made.content))
    except (InputError, TooLongError) as error:
        ended = str(error)
    return (math.nan if ended else loop.time - began), said


def main() -> int:
    """Measure and tell."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("plants", nargs="*", default=known_plants())
    parser.add_argument("--seeds", type=int, default=4)
    given = parser.parse_args()
    seeds = range(1, given.seeds + 1)
    print("| plant | time constant s |" + "".join(f" seed {seed} |" for seed in seeds) + " taken over said |")
    print("| --- |" + " ---: |" * (given.seeds + 2))
    lengths = []
    with ProcessPoolExecutor(2) as pool:
        constants = pool.map(time_constant, given.plants)
        taken = [[pool.submit(duration, name, seed) for seed in seeds] for name in given.plants]
        for name, constant, found in zip(given.plants, constants, taken, strict=True):
            took, said = np.array([one.result() for one in found]).T
            lengths.append(took / constant)
            figures = " | ".join(f"{length:.1f}" for length in lengths[-1])
            share = took / said
            print(f"| {name} | {constant:.3g} | {figures} | {share.min():.2f} to {share.max():.2f} |", flush=True)
    print("| median | | " + " | ".join(f"{length:.1f}" for length in np.nanmedian(lengths, axis=0)) + " | |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
