"""Growth of the nodes' memory beside a running loop: ``python -m fopid_ros.benchmarks.soak 1600`` (seconds)."""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

from fopid_ros.benchmarks.cpu import cpu_seconds
from fopid_ros.benchmarks.idle import memory
from fopid_ros.experiment.child_processes import Children, command, ros_arguments

LOOK_PERIOD = 30.0  # [s]
WARM_UP = 660.0
"""The tuner's history of 600 s fills, and the dashboard's; what grows behind that grows for ever [s]."""

NODES = {
    "plant_simulator": ros_arguments({"process": "P1", "noise_std": 0.01}),
    "fopid_controller": ros_arguments({"kp": 0.9, "ki": 0.3, "setpoint.initial": 1.0}),
    "fopid_tuner": ros_arguments({"process": "P1"}),
    "dashboard": ["--port", "0"],
}


def growth(times: list[float], resident: list[float]) -> float:
    """Slope of the straight line through the memory from ``WARM_UP`` on [MB/h].

    Examples
    --------
    >>> round(growth([0.0, 700.0, 1000.0, 1300.0], [50.0, 70.0, 70.1, 70.2]), 6)
    1.2
    """
    kept = np.array(times) > WARM_UP
    return float(np.polyfit(np.array(times)[kept], np.array(resident)[kept], 1)[0]) * 3600.0


def main() -> int:
    """Run a loop at 100 Hz for a while; a line for each look, and the growth of each node at the end."""
    parser = argparse.ArgumentParser(prog="soak", description=__doc__)
    parser.add_argument("seconds", type=float, help=f"how long; growth is told from {WARM_UP:g} s on")
    seconds = parser.parse_args().seconds
    times: list[float] = []
    resident: dict[str, list[float]] = {name: [] for name in NODES}
    with Children() as children:
        for name, arguments in NODES.items():
            children.start(name, [command(name), *arguments])
        ids, begun = children.process_ids(), time.monotonic()
        while (now := time.monotonic() - begun) < seconds and children.ended() is None:
            time.sleep(min(LOOK_PERIOD, seconds - now))
            times.append(time.monotonic() - begun)
            for name, process_id in ids.items():
                resident[name].append(memory(process_id)[0])
            print(f"{times[-1]:6.0f} s", *(f"{name} {resident[name][-1]:.2f} MB" for name in NODES), flush=True)
        shares = {name: cpu_seconds(process_id) / times[-1] for name, process_id in ids.items()}
    for name in NODES:
        slope = growth(times, resident[name]) if times[-1] > WARM_UP + 2 * LOOK_PERIOD else float("nan")
        print(f"{name:18} {slope:+.2f} MB/h from {WARM_UP:g} s on, {shares[name]:.1%} of a core")
    return 0


if __name__ == "__main__":
    sys.exit(main())
