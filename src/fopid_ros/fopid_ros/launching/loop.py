"""The parameters of a loop's three nodes, from what somebody says when starting it."""

from __future__ import annotations

from pathlib import Path

from ament_index_python.packages import get_package_share_directory

from fopid_core.errors import InputError
from fopid_core.model.process import TEST_BENCH
from fopid_core.study.experiments.demonstration import demo_experiment

EXECUTABLES = ("plant_simulator", "fopid_controller", "fopid_tuner")
FASTEST, USUAL = 0.001, 0.01
"""Least and largest time between samples that is chosen for a loop in real time [s]."""


def loop_parameters(process: str, params_file: str) -> dict[str, list[object]]:
    """What each node is started with: parameter files and parameters, in this order.

    Parameters
    ----------
    process : str
        P1 ... P4 or a transfer function in s; empty for what the file says, or P1 without one.
    params_file : str
        Path of a parameter file for all nodes; empty for none. P1 ... P4 have one each, with the gains of the paper.
        For any other process a PI is chosen that is modest and proved stable.

    Raises
    ------
    InputError
        If there is no such file, or no gains can be chosen for the process.

    Examples
    --------
    >>> loop_parameters("2/(s+1)^3", "")["fopid_controller"]
    [{'sample_time': 0.008, 'kp': 0.34, 'ki': 0.14, 'kd': 0.0, 'lam': 1.0, 'mu': 1.0, 'setpoint.initial': 1.0}]
    """
    name = process.strip()
    if params_file:
        asked: list[object] = [{"process": name}] if name else []
        return _for_each([existing_file(params_file)], plant=asked, tuner=asked)
    if name in ("", *TEST_BENCH):
        return _for_each([installed_config(name or "P1")])
    chosen = demo_experiment(name)
    if chosen.sample_time < FASTEST:
        raise InputError(
            f"process = {name!r} needs a sample every {chosen.sample_time:g} s; allowed: {FASTEST:g} s and more, or "
            "give a params_file"
        )
    timing = {"sample_time": min(chosen.sample_time, USUAL)}
    asked = [{**timing, "process": name}]
    return _for_each([], asked, [{**timing, **chosen.gains, "setpoint.initial": 1.0}], asked)


def installed_config(name: str) -> str:
    """The path of a parameter file that comes with the package."""
    return str(Path(get_package_share_directory("fopid_ros"), "config", f"{name}.yaml"))


def existing_file(params_file: str) -> str:
    """The path of a parameter file; raises InputError if there is none."""
    file = Path(params_file).expanduser()
    if not file.is_file():
        raise InputError(f"params_file = {params_file!r}; allowed: the path of a file that exists")
    return str(file)


def _for_each(
    files: list[object], plant: list[object] | None = None, controller: list[object] | None = None,
    tuner: list[object] | None = None,
) -> dict[str, list[object]]:  # fmt: skip
    return {name: [*files, *(own or [])] for name, own in zip(EXECUTABLES, (plant, controller, tuner), strict=True)}
