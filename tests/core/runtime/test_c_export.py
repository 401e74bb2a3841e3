"""The controller in C is the controller in Python, call by call, under a compiler that lets nothing pass."""

from __future__ import annotations

import json
import math
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import Result

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.runtime.c_export import _vectors, c_header, c_test
from fopid_core.runtime.controller import ControllerSettings, FopidController

from ..cli.runner import invoke

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic")
ITAE = Fopid(2.9692, 0.8028, 1.3394, 1.0138, 0.6074)
CLASSICAL = Fopid(1.0, 0.5, 0.1)
CONTROLLERS = {
    "limits": ControllerSettings(ITAE, control_min=-1.0, control_max=1.5),
    "no limits": ControllerSettings(Fopid(1.0, 0.5, 0.02, 0.7, 1.3)),
    "rate": ControllerSettings(CLASSICAL, control_max=1.2, control_rate_max=5.0, antiwindup="conditional_integration"),
    "no anti-windup": ControllerSettings(CLASSICAL, control_max=1.2, antiwindup="none"),
    "reverse": ControllerSettings(Fopid(-0.5, -0.1, -0.01, 0.9, 0.5), control_max=1.0),
    "everything": ControllerSettings(
        Fopid(0.5, 0.1, 0.01, 0.9, 0.5), control_max=1.2, tracking_time=2.0, derivative_filter_time=0.05,
        derivative_setpoint_weight=0.0, setpoint_weight=0.5, setpoint_rate_max=3.0, deadband=0.01, safe_control=0.1,
    ),
    "no integral": ControllerSettings(Fopid(1.2, 0.0, 0.1, 1.0, 0.8), control_max=2.0, safe_control=0.1),
    "order 0": ControllerSettings(Fopid(0.5, 0.5, 0.1, 0.0, 0.8)),
    "measurement filter of order 1": ControllerSettings(
        ITAE, control_max=1.5, measurement_filter_order=1, measurement_filter_time=0.03
    ),
    "measurement filter of order 2": ControllerSettings(
        CLASSICAL, control_max=1.5, measurement_filter_order=2, measurement_filter_time=0.1, setpoint_weight=0.3,
        derivative_setpoint_weight=0.0,
    ),
    "inverse not stable": ControllerSettings(Fopid(1.0, 1.0, 0.001, 1.0, 2.0), control_max=1.0),
}  # fmt: skip

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")


def compile_and_run(folder: Path, source: str, *flags: str) -> str:
    program = folder / "program"
    subprocess.run(["cc", *STRICT, *flags, source, "-o", program], cwd=folder, check=True, timeout=60)
    return subprocess.run([program], capture_output=True, text=True, check=True, timeout=60).stdout


def told_by_c(folder: Path, ticks: int, inputs: str, part: str) -> float:
    """A part of the state after so many ticks k with these inputs."""
    (folder / "main.c").write_text(
        '#include "loop.h"\n#include <math.h>\n#include <stdio.h>\n'
        "int main(void) { static loop_state c; int k; loop_init(&c);"
        f" for (k = 0; k < {ticks}; k++) loop_step(&c, {inputs});"
        f' printf("%.17g", c.{part}); return 0; }}\n'
    )
    return float(compile_and_run(folder, "main.c"))


def write(folder: Path, settings: ControllerSettings) -> None:
    (folder / "loop.h").write_text(c_header(settings, "loop"))
    (folder / "loop_test.c").write_text(c_test(settings, "loop"))


@pytest.mark.parametrize("kind", CONTROLLERS)
def test_every_control_agrees_with_limits_manual_hold_and_reset(kind: str, tmp_path: Path) -> None:
    # The sums run in another order: rounding of 1e-16 times the size of the terms, third differences among them.
    write(tmp_path, CONTROLLERS[kind])
    calls, largest = compile_and_run(tmp_path, "loop_test.c").split(" calls, largest difference ")
    assert int(calls) > 400
    assert float(largest) < 1e-10


@pytest.mark.parametrize("kind", ["limits", "everything"])
def test_in_single_precision_it_agrees_to_its_digits(kind: str, tmp_path: Path) -> None:
    write(tmp_path, CONTROLLERS[kind])
    largest = compile_and_run(tmp_path, "loop_test.c", "-DLOOP_REAL=float").split()[-1]
    assert 1e-9 < float(largest) < 1e-3


def test_the_vectors_reach_what_they_are_for() -> None:
    text = c_test(CONTROLLERS["limits"], "loop")
    for call in ("STEP", "HOLD", "MANUAL", "LIMITS", "RESET"):
        assert f"{{{call}, " in text
    controls = [
        float(line.rstrip("},").rsplit(", ", 1)[1]) for line in text.splitlines() if line.startswith("    {STEP")
    ]
    assert controls.count(1.5) > 5
    assert controls.count(0.3) > 10


@pytest.mark.parametrize(
    ("gains", "sample_time"),
    [(Fopid(1e-4, 1e-5), 0.01), (Fopid(500.0, 80.0, 20.0, 0.9, 0.8), 1e-4), (Fopid(1.0, 0.5, 0.1, 0.8), 1e5)],
)
def test_the_vectors_saturate_and_stay_finite_for_any_gains_and_sample_time(gains: Fopid, sample_time: float) -> None:
    settings = ControllerSettings(gains, sample_time=sample_time)
    rows, scale = _vectors(settings, 400)
    low, high = next(row[1:3] for row in rows if row[0] == "LIMITS")
    assert max(abs(row[-1]) for row in rows) <= scale < math.inf
    assert sum(row[-1] in (low, high) for row in rows) > 5


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    result = export("--gains", "1,1,0,1,1", "--out", str(tmp_path / "file" / "out"))
    assert (result.exit_code, result.stderr.count("\n")) == (2, 1)
    assert "out " in result.stderr


def test_numbers_and_truths_are_typed_as_the_node_reads_them(tmp_path: Path) -> None:
    more = "--set band.poles=9 --set band.low=0.01 --set bumpless=false --set antiwindup=none"
    result = export("--gains", "1,.5,.1,.9,.8", *more.split(), "--name", "loop", "--out", str(tmp_path))
    assert result.exit_code == 0
    assert "by 10 lags" in (tmp_path / "loop.h").read_text()


def test_a_wrong_header_is_noticed(tmp_path: Path) -> None:
    write(tmp_path, CONTROLLERS["limits"])
    other = replace(CONTROLLERS["limits"], gains=replace(ITAE, ki=0.8029))
    (tmp_path / "loop.h").write_text(c_header(other, "loop"))
    with pytest.raises(subprocess.CalledProcessError):
        compile_and_run(tmp_path, "loop_test.c")


def test_its_own_example_compiles_and_closes_the_loop(tmp_path: Path) -> None:
    write(tmp_path, CONTROLLERS["limits"])
    last = compile_and_run(tmp_path, "loop.h", "-DLOOP_EXAMPLE", "-x", "c").splitlines()[-1]
    assert float(last.split("measurement ")[1].split(",")[0]) == pytest.approx(1.0, abs=0.02)


@pytest.mark.skipif(shutil.which("c++") is None, reason="no C++ compiler")
@pytest.mark.parametrize("standard", ["c++11", "c++20"])
def test_it_is_cplusplus_as_well(standard: str, tmp_path: Path) -> None:
    write(tmp_path, ControllerSettings(Fopid(2.0, 1.0, 0.5, 0.9, 0.7)))
    command = ["c++", f"-std={standard}", "-Wall", "-Werror", "-x", "c++", "loop_test.c", "-o", "cplusplus"]
    subprocess.run(command, cwd=tmp_path, check=True, timeout=60)
    assert subprocess.run([tmp_path / "cplusplus"], check=False, timeout=60).returncode == 0


def test_an_input_that_is_not_finite_is_a_hold(tmp_path: Path) -> None:
    write(tmp_path, CONTROLLERS["limits"])
    found = told_by_c(tmp_path, 20, "1, k == 10 || k == 11 ? NAN : 0.01 * k, 0, 0", "control")
    controller = FopidController(CONTROLLERS["limits"])
    for k in range(20):
        if k in (10, 11):
            controller.hold()
        else:
            controller.step(1.0, 0.01 * k)
    assert found == pytest.approx(controller.state.control, abs=1e-12)


def test_a_feedforward_far_beyond_the_limits_counts_as_their_range(tmp_path: Path) -> None:
    write(tmp_path, CONTROLLERS["limits"])
    found = told_by_c(tmp_path, 40, "1, 0.01 * k, k == 10 || k == 11 ? 1e9 : 0, 0", "integral")
    controller = FopidController(CONTROLLERS["limits"])
    for k in range(40):
        controller.step(1.0, 0.01 * k, feedforward=1e9 * (k in (10, 11)))
    assert found == pytest.approx(controller.state.integral, abs=1e-12)
    assert abs(controller.state.integral) < 10.0


def test_two_controllers_share_a_program(tmp_path: Path) -> None:
    for name in ("left", "right"):
        (tmp_path / f"{name}.h").write_text(c_header(CONTROLLERS["rate"], name))
    (tmp_path / "main.c").write_text(
        '#include "left.h"\n#include "right.h"\n'
        "int main(void) { static left_state l; static right_state r; left_init(&l); right_init(&r);"
        " return left_step(&l, 1, 0, 0, 0) != right_step(&r, 1, 0, 0, 0); }\n"
    )
    compile_and_run(tmp_path, "main.c")


@pytest.mark.parametrize("name", ["", "9lives", "a-b", "a b"])
def test_a_name_that_c_does_not_take_is_named(name: str) -> None:
    with pytest.raises(InputError, match="name "):
        c_header(CONTROLLERS["rate"], name)


def export(*arguments: str) -> Result:
    return invoke(["export", *arguments])


def test_the_verb_writes_both_files_and_one_json_object(tmp_path: Path) -> None:
    typed = "--gains 1,.5,.1,.9,.8 --sample-time 0.02 --limits 0,5 --set antiwindup=conditional_integration --name loop"
    result = export(*typed.split(), "--out", str(tmp_path), "--json")
    assert result.exit_code == 0
    data = json.loads(result.stdout)
    assert data["gains"] == {"kp": 1.0, "ki": 0.5, "kd": 0.1, "lam": 0.9, "mu": 0.8}
    assert (data["sample_time"], data["control_min"], data["control_max"]) == (0.02, 0.0, 5.0)
    assert "conditional integration" in Path(data["header"]).read_text()
    assert float(compile_and_run(tmp_path, Path(data["test"]).name).split()[-1]) < 1e-11


def test_filter_and_weights_are_the_parameters_of_the_node(tmp_path: Path) -> None:
    options = ["--filter", "2,0.1", "--setpoint-weights", "0.7,0"]
    values = {"measurement_filter_order": 2, "measurement_filter_time": 0.1,
              "setpoint_weight": 0.7, "derivative_setpoint_weight": 0.0}  # fmt: skip
    parameters = [word for name, value in values.items() for word in ("--set", f"{name}={value}")]
    texts = []
    for more in (options, parameters, []):
        result = export("--gains", "1,0.5,0.1,0.9,0.8", *more, "--out", str(tmp_path))
        assert result.exit_code == 0, result.stderr
        texts.append((tmp_path / "fopid_controller.h").read_text())
    assert texts[0] == texts[1] != texts[2]


def test_the_verb_reads_the_nodes_parameter_file(tmp_path: Path) -> None:
    file = tmp_path / "saved.yaml"
    file.write_text(
        "/plant_simulator:\n  ros__parameters:\n    process: P1\n"
        "/fopid_controller:\n  ros__parameters:\n    kp: 2\n    ki: 0.5\n    lam: 0.9\n    sample_time: 0.05\n"
        "    control_max: .inf\n    control_min: -1.0\n    band: {low: 0.01}\n    trigger: realtime\n"
    )
    data = json.loads(export("--params", str(file), "--out", str(tmp_path), "--json").stdout)
    assert (data["gains"]["kp"], data["gains"]["lam"], data["sample_time"]) == (2.0, 0.9, 0.05)
    assert data["control_min"] == -1.0
    assert "met from 0.01 to" in Path(data["header"]).read_text()


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ([], "gains missing"),
        (["--gains", "1,2"], "five numbers"),
        (["--gains", "1,1,0,1,1", "--limits", "5"], "limits '5'"),
        (["--gains", "1,1,0,1,1", "--limits", "5,x"], "limits = 'x'"),
        (["--gains", "1,1,0,1,1", "--limits", "5,1"], "control_min = 5.0"),
        (["--gains", "1,1,0,1,1", "--set", "horizn=3"], "parameter 'horizn'"),
        (["--gains", "1,1,0,1,1", "--set", "horizon"], "set 'horizon'"),
        (["--gains", "1,1,0,1,1", "--name", "a-b"], "name 'a-b'"),
        (["--gains", "1,1,0,1,1", "--set", "band.poles=7.5"], "band.poles = '7.5'; allowed: a whole number"),
        (["--gains", "1,1,0,1,1", "--set", "bumpless=maybe"], "bumpless = 'maybe'; allowed: true, false"),
        (["--gains", "1,1,0,1,1", "--sample-time", "0"], "sample_time = 0.0"),
        (["--gains", "1e40,1,0,1,1"], "1e+40 in the controller; allowed in C: up to 1e+30"),
        (["--params", "nowhere.yaml"], "params nowhere.yaml"),
    ],
)
def test_bad_input_ends_in_one_line_and_status_2(arguments: list, named: str, tmp_path: Path) -> None:
    result = export(*arguments, "--out", str(tmp_path / "out"))
    assert result.exit_code == 2
    assert named in result.stderr
    assert result.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()
