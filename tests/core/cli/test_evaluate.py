"""``fopid evaluate``, ``step`` and ``region`` keep the contract: one JSON object, exit status, one-line errors."""

from __future__ import annotations

import json
import math
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import Result

from fopid_core.data import paper_tables
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import read_process
from fopid_core.model.two_degrees import MeasurementFilter, SetpointWeights

from .runner import invoke

GAINS = "2.9692,0.8028,1.3394,1.0138,0.6074"


def run(*arguments: str) -> Result:
    return invoke(arguments)


def answer(*arguments: str) -> dict[str, Any]:
    result = run(*arguments, "--json")
    assert (result.exit_code, result.stderr) == (0, "")
    assert len(result.stdout.splitlines()) == 1
    found: dict[str, Any] = json.loads(result.stdout, parse_constant=lambda name: pytest.fail(f"{name} in JSON"))
    return found


def test_evaluate_gives_all_keys_of_the_contract() -> None:
    found = answer("evaluate", "P1", "--gains", GAINS, "--horizon", "50")
    assert found.keys() >= {
        "indices", "overshoot_pct", "rise_time", "settling_time", "ms", "mt", "margins", "stable", "unstable_poles",
        "control_peak",
    }  # fmt: skip
    assert found["indices"].keys() == {"iae", "ise", "itae", "itse", "istes", "istse", "sum"}
    row = next(r for r in paper_tables()["table4_to_7"] if (r["process"], r["index"]) == ("P1", "ITAE"))
    assert found["indices"]["itae"] == pytest.approx(row["exact"]["J"], rel=1e-3)
    assert found["overshoot_pct"] == pytest.approx(row["exact"]["overshoot_pct"], abs=0.01)
    assert (found["stable"], found["unstable_poles"], found["control_peak"]) == (True, 0, None)


def test_evaluate_with_gl1_gives_the_papers_figures() -> None:
    found = answer("evaluate", "P1", "--gains", GAINS, "--horizon", "50", "--method", "gl1", "--step", "0.01")
    assert found["indices"]["itae"] == pytest.approx(5.2762, rel=1e-3)
    assert math.isfinite(found["control_peak"])


def test_angles_are_degrees_and_margins_in_decibels_too() -> None:
    margins = answer("evaluate", "1/s", "--gains", "2,0,0,1,1")["margins"]
    assert margins["phase_margin_deg"] == pytest.approx(90.0)
    assert answer("evaluate", "P1", "--gains", "2,0,0,1,1")["margins"]["gain_margin_db"] == pytest.approx(
        20.0 * math.log10(4.0)
    )


@pytest.mark.parametrize(
    ("gains", "stable", "poles", "decided"),
    [("9,0,0,1,1", False, 2, True), ("8,0,0,1,1", False, None, False), ("-1.5,0,0,1,1", False, 1, True)],
)
def test_a_loop_that_is_not_stable_is_answered_without_indices(
    gains: str, stable: bool, poles: int | None, decided: bool
) -> None:
    found = answer("evaluate", "P1", "--gains", gains)
    assert (found["stable"], found["unstable_poles"], found["decided"]) == (stable, poles, decided)
    assert set(found["indices"].values()) == {None}
    assert found["overshoot_pct"] is None


def test_negative_and_zero_gains_and_a_process_that_begins_with_a_minus_are_taken() -> None:
    found = answer("evaluate", "-2/(s+1)", "--gains", "-1,-0.5,0,1,1")
    assert found["stable"] is True
    assert answer("evaluate", "P1", "--gains", "0,0,0,1,1")["mt"] == 0.0


def test_a_filter_and_weights_of_the_setpoint_are_part_of_the_loop() -> None:
    designed = ("--gains", "1,0.4,0.5,1,1", "--filter", "2,0.1", "--setpoint-weights", "0.7,0")
    loop = Loop(read_process("P1"), Fopid(1.0, 0.4, 0.5), MeasurementFilter(2, 0.1), SetpointWeights(0.7, 0.0))
    w = np.geomspace(0.01, 100.0, 20001)
    found = answer("evaluate", "P1", *designed)
    assert found["ms"] == pytest.approx(np.max(np.abs(1.0 / (1.0 + loop(1j * w)))), rel=1e-5)
    first = answer("step", "P1", *designed, "--horizon", "10", "--points", "11")["control"][0]
    assert first == pytest.approx(0.7)  # the proportional part alone sees the step, and not all of it


def test_step_gives_as_many_points_as_asked_for() -> None:
    found = answer("step", "1/(s+1)", "--gains", "1,0,0,1,1", "--horizon", "2", "--points", "5")
    assert found["time"] == [0.0, 0.5, 1.0, 1.5, 2.0]
    assert found["output"] == pytest.approx([0.5 * (1.0 - math.exp(-2.0 * t)) for t in found["time"]], abs=1e-7)
    assert found["control"] == pytest.approx([1.0 - y for y in found["output"]], abs=1e-7)


def test_step_of_the_load_settles_at_zero_under_integral_action() -> None:
    found = answer("step", "P1", "--gains", "1,0.4,0.5,1,1", "--input", "load")
    assert found["output"][-1] == pytest.approx(0.0, abs=1e-3)
    assert max(found["output"]) > 0.1


def test_an_infinite_control_is_null() -> None:
    found = answer("step", "P1", "--gains", GAINS, "--points", "3")
    assert found["control"][0] is None
    assert all(math.isfinite(u) for u in found["control"][1:])


@pytest.mark.parametrize("suffix", ["png", "svg"])
def test_step_draws_a_picture(tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"step.{suffix}"
    assert answer("step", "P1", "--gains", GAINS, "--plot", str(file))["plot"] == str(file)
    assert file.stat().st_size > 5000


def test_region_gives_data_and_a_picture(tmp_path: Path) -> None:
    file = tmp_path / "region.png"
    found = answer("region", "P1", "--orders", "0.9,1.1", "--kd", "0.5", "--points", "20", "--plot", str(file))
    assert (len(found["kp"]), len(found["ki"]), len(found["stable"]), len(found["stable"][0])) == (20, 20, 20, 20)
    assert found["curve"].keys() == {"frequency", "kp", "ki", "border"}
    w, kp, ki = (found["curve"][name][700] for name in ("frequency", "kp", "ki"))
    loop = Loop(read_process("P1"), Fopid(kp, ki, 0.5, 0.9, 1.1))
    assert complex(loop(1j * w)) == pytest.approx(-1.0)
    assert file.stat().st_size > 5000


@pytest.mark.parametrize(("verb", "row"), [("evaluate", "stable"), ("step", "last output"), ("region", "kp in view")])
def test_without_json_people_get_a_table(verb: str, row: str) -> None:
    result = run(verb, "P1", *(() if verb == "region" else ("--gains", GAINS)))
    assert result.exit_code == 0
    assert re.search(rf"^  {row}  +\S", result.stdout, re.MULTILINE)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("evaluate", "1/(s", "--gains", GAINS), ("'1/(s'", "character 5", "allowed: ')'")),
        (("evaluate", "P1", "--gains", "1,2"), ("gains '1,2'", "KP,KI,KD,LAM,MU")),
        (("evaluate", "P1", "--gains", "1,1,1,3,1"), ("lam = 3.0", "allowed: 0 to 2")),
        (("evaluate", "P1", "--gains", "nan,1,1,1,1"), ("kp = nan", "allowed: a finite number")),
        (("evaluate", "P1", "--gains", GAINS, "--horizon", "-5"), ("horizon = -5.0", "allowed: 1e-12 to 1e+12 s")),
        (("evaluate", "P1", "--gains", GAINS, "--horizon", "x"), ("--horizon", "'x'")),
        (("evaluate", "P1", "--gains", GAINS, "--method", "rk4"), ("'--method'", "'rk4'", "'exact', 'gl1'")),
        (("evaluate", "P1", "--gains", GAINS, "--method", "gl1", "--step", "0"), ("step = 0.0", "allowed: above 0")),
        (("evaluate", "P1"), ("--gains",)),
        (("evaluate", "s", "--gains", GAINS), ("not proper",)),
        (("evaluate", "P1", "--gains", GAINS, "--filter", "3,0.1"), ("filter order = 3", "allowed: 0, 1 or 2")),
        (("evaluate", "P1", "--gains", GAINS, "--filter", "1.5,0.1"), ("filter order = 1.5", "allowed: 0, 1 or 2")),
        (("step", "P1", "--gains", GAINS, "--filter", "2"), ("filter '2'", "ORDER,TIME")),
        (("step", "P1", "--gains", GAINS, "--setpoint-weights", "2,0"), ("= 2.0", "allowed: 0 to 1")),
        (("evaluate", "none.yaml", "--gains", GAINS), ("none.yaml", "cannot be read")),
        (("evaluate", "P1", "--gains", GAINS, "--speed", "3"), ("--speed",)),
        (("step", "P1", "--gains", GAINS, "--input", "noise"), ("'--input'", "'noise'", "'setpoint', 'load'")),
        (("step", "P1", "--gains", GAINS, "--points", "1"), ("points = 1", "allowed: at least 2")),
        (("region", "P1", "--orders", "1"), ("orders '1'", "LAM,MU")),
        (("region", "P1", "--orders", "2,1"), ("lam = 2", "allowed")),
        (("juggle",), ("juggle",)),
    ],
)
def test_bad_input_is_one_line_on_stderr_and_status_two(arguments: tuple[str, ...], says: tuple[str, ...]) -> None:
    result = run(*arguments)
    assert (result.exit_code, result.stdout) == (2, "")
    assert len(result.stderr.splitlines()) == 1
    assert all(part in result.stderr for part in says)
    assert "Usage" not in result.stderr
    assert "Traceback" not in result.stderr


def test_the_controllers_path_imports_no_heavy_library() -> None:
    code = "import sys, fopid_core.model.fopid; print([m for m in ('scipy', 'control', 'lark') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("reduce p1", "did you mean P1?"),
        ("tune time P1 --index ITAE", "did you mean itae?"),
        ("tune frequency P1 --phasemargin 60", "no option --phasemargin;"),
        ("tune frequency --phasemargin=60 P1", "did you mean --phase-margin?"),
        ("tune rule P1 --rule amigo_pid", "did you mean amigo-pid?"),
        ("tunee time P1", "tune"),
    ],
)
def test_a_misspelt_name_is_answered_with_the_nearest_right_one(line: str, said: str) -> None:
    result = invoke(line.split())
    assert result.exit_code == 2
    assert said in result.stderr
    assert len(result.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    ("verb", "option", "name", "allowed"),
    [
        (("identify", "record.csv"), "--plot", ".", "a file, not a folder"),
        (("identify", "record.csv"), "--plot", "none/fit.png", "in a folder that is there"),
        (("tune", "time", "1/(s+1)^3"), "--plot", "picture.docx", "a name that ends in .png, .svg, .pdf, .jpg"),
        (("replay", "record.csv"), "--out", "none/replayed.csv", "in a folder that is there"),
        (("design", "record.csv"), "--out", "none/report.html", "in a folder that is there"),
        (("compare", "1/(s+1)^3"), "--page", "none/page.html", "in a folder that is there"),
        (("front", "1/(s+1)^3"), "--csv", "none/front.csv", "in a folder that is there"),
    ],
)
def test_a_file_that_cannot_be_written_is_refused_before_anything_is_done(
    verb: tuple[str, ...], option: str, name: str, allowed: str
) -> None:
    """The records are not there, which would be said first if they were read first."""
    result = run(*verb, option, name)
    assert result.exit_code == 2
    assert f"'{option}': {name!r}; allowed: {allowed}" in result.stderr
