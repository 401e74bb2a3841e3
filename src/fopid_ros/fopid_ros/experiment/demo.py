"""The demonstration: starts the four nodes as separate processes and watches over them."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from fopid_ros.experiment.with_nodes import interruptible, run_with_nodes


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="fopid_demo", description="Run a loop over ROS 2, tune it twice while it runs, record it, report."
    )
    parser.add_argument("--process", default="P1", help="P1 ... P4 or a transfer function in s (P1)")
    parser.add_argument("--trigger", default="lockstep", choices=("lockstep", "realtime"), help="how time passes")
    parser.add_argument("--out", type=Path, help="folder for bag and report (runs/demo-TIME)")
    return parser


def main(args: Sequence[str] | None = None) -> int:
    """Entry point of the command ``fopid_demo``."""
    return interruptible(lambda: _run(_parser().parse_args(args)))


def _run(options: argparse.Namespace) -> int:
    # Slow to import: an interrupt is heard before.
    from fopid_core.study.experiments.demonstration import demo_experiment
    from fopid_core.study.experiments.experiment import run_folder

    experiment = demo_experiment(options.process, options.trigger)
    return run_with_nodes(experiment, options.out or run_folder("demo"))


if __name__ == "__main__":
    sys.exit(main())
