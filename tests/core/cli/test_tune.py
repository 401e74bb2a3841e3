"""``fopid reduce``, ``tune`` and ``benchmark`` keep the contract: one JSON object, exit status, one-line errors."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import Result
from rosbags.rosbag2 import StoragePlugin

from fopid_core.data import paper_tables
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.margins import margins
from fopid_core.model.process import read_process
from fopid_core.model.templates import TEMPLATES
from fopid_core.runtime.controller import ControllerSettings, FopidController
from fopid_core.study.records import read_record

from ..design.identification.recorded import step_record
from ..study.recording import EXPERIMENT, Recording, record_loop
from .runner import invoke

PAPERS_BOUNDS = ("--t-max", "-40@10", "--s-max", "-40@0.01")


def run(*arguments: str) -> Result:
    return invoke(arguments)


def answer(*arguments: str, status: int = 0) -> dict[str, Any]:
    result = run(*arguments, "--json")
    assert (result.exit_code, result.stderr) == (status, "")
    assert len(result.stdout.splitlines()) == 1
    found: dict[str, Any] = json.loads(result.stdout, parse_constant=lambda name: pytest.fail(f"{name} in JSON"))
    return found


def test_reduce_gives_all_templates_and_the_preferred_one() -> None:
    found = answer("reduce", "P1")
    assert [model["template"] for model in found["models"]] == ["foptd", "nioptd1", "soptd", "nioptd2"]
    assert found["preferred"] == "nioptd2"
    for model in found["models"]:
        assert model.keys() >= {"template", "parameters", "h2_error", "elapsed_s"}
        assert set(model["parameters"]) == set(TEMPLATES[model["template"]].parameters)


def test_reduce_gives_one_template_when_asked_and_can_keep_the_gain() -> None:
    (model,) = answer("reduce", "-2/(s+1)^4", "--template", "soptd", "--keep-gain")["models"]
    assert model["parameters"]["K"] / model["parameters"]["a0"] == pytest.approx(-2.0)


def test_tune_frequency_gives_all_keys_of_the_contract() -> None:
    found = answer("tune", "frequency", "P2", "--phase-margin", "80", "--crossover", "1", *PAPERS_BOUNDS)
    assert found.keys() >= {"success", "gains", "achieved", "stable", "unmet", "elapsed_s"}
    assert found["gains"].keys() == {"kp", "ki", "kd", "lam", "mu"}
    achieved = found["achieved"]
    assert achieved.keys() >= {
        "phase_margin_deg", "crossover", "phase_slope", "t_db", "s_db", "ms", "mt", "gain_margin_db",
    }  # fmt: skip
    assert (found["success"], found["stable"], found["unmet"]) == (True, True, [])
    assert achieved["phase_margin_deg"] == pytest.approx(80.0, abs=1e-6)
    measured = margins(Loop(read_process("P2"), Fopid(**found["gains"])))
    assert math.degrees(measured.phase_margin) == pytest.approx(80.0, abs=1e-6)


def test_what_cannot_be_met_leaves_with_3_and_says_why() -> None:
    found = answer("tune", "frequency", "P1", "--phase-margin", "80", "--crossover", "0.3", *PAPERS_BOUNDS, status=3)
    assert found["success"] is False
    assert len(found["unmet"]) == 2
    assert found["gains"] is not None


def test_tune_via_a_reduced_model_is_verified_on_the_process() -> None:
    found = answer("tune", "frequency", "P1", "--phase-margin", "70", "--crossover", "0.4", "--via", "nioptd2")
    assert found["achieved"]["phase_margin_deg"] == pytest.approx(70.0, abs=1.0)
    assert found["achieved"]["phase_margin_deg"] != pytest.approx(70.0, abs=1e-6)


def test_tune_frequency_keeps_the_control_within_a_bound() -> None:
    arguments = ("--phase-margin", "60", "--crossover", "0.5", "--u-max", "5", "--sample-time", "0.02")
    found = answer("tune", "frequency", "P1", *arguments)
    first = FopidController(ControllerSettings(Fopid(**found["gains"]), sample_time=0.02)).step(1.0, 0.0)
    assert first <= 5.0 * 1.001


def test_tune_rule_places_poles_where_asked() -> None:
    gains = answer("tune", "rule", "1/(s^2+s+1)", "--rule", "dominant-poles", "--crossover", "2")["gains"]
    poles = np.roots([1.0, 1.0 + gains["kd"], 1.0 + gains["kp"], gains["ki"]])
    assert np.abs(poles).min() == pytest.approx(2.0)


def test_tune_time_gives_cost_and_evaluations_too() -> None:
    found = answer("tune", "time", "P1", "--index", "itae", "--horizon", "50", "--ms-max", "1.6", "--u-max", "20")
    assert found.keys() >= {"success", "gains", "achieved", "stable", "unmet", "elapsed_s", "cost", "evaluations"}
    assert found["cost"] < 2.6
    assert found["achieved"]["ms"] <= 1.6


def test_tune_time_takes_fixed_numbers_ranges_and_weights() -> None:
    arguments = ("--index", "sum", "--fix", "lam=1", "--fix", "mu=1", "--bound", "kd=0,0.1", "--weight", "iae=1")
    gains = answer("tune", "time", "P1", *arguments, "--start", "1,0.4,0.1,1,1")["gains"]
    assert (gains["lam"], gains["mu"]) == (1.0, 1.0)
    assert 0.0 <= gains["kd"] <= 0.1


def test_tune_rule_reads_off_a_rule() -> None:
    found = answer("tune", "rule", "P1", "--rule", "fmigo")
    assert found["gains"]["kd"] == 0.0
    assert "F-MIGO" in found["message"]


def test_a_rule_out_of_range_leaves_with_3() -> None:
    found = answer("tune", "rule", "1/(100s+1)*exp(-s)", "--rule", "valerio-1", status=3)
    assert (found["gains"], found["achieved"]) == (None, None)
    assert "valid for" in found["unmet"][0]


def test_a_process_may_begin_with_a_minus_sign() -> None:
    assert answer("tune", "rule", "-2/(3s+1)*exp(-s)", "--rule", "simc-pi")["gains"]["kp"] < 0.0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("reduce", "1/s"), ["not stable"]),
        (("reduce", "P1", "--template", "third"), ["template", "'third'", "foptd"]),
        (("tune", "frequency", "P1", "--phase-margin", "190"), ["phase-margin", "190 deg", "up to 180"]),
        (("tune", "frequency", "P1", "--phase-margin", "nan"), ["phase-margin", "nan"]),
        (("tune", "frequency", "P1", "--crossover", "-1"), ["crossover", "-1"]),
        (("tune", "frequency", "P1", "--t-max", "-40"), ["t-max", "'-40'", "-40@10"]),
        (("tune", "frequency", "P1", "--t-max", "x@10"), ["t-max", "'x'", "a number"]),
        (("tune", "frequency", "P1", "--via", "fourth"), ["via", "'fourth'", "nioptd2"]),
        (("tune", "time", "P1", "--index", "best"), ["index", "'best'", "itae"]),
        (("tune", "time", "P1", "--ms-max", "0.9"), ["ms_max", "0.9", "above 1"]),
        (("tune", "time", "P1", "--fix", "lam"), ["fix", "'lam'", "NAME=VALUE"]),
        (("tune", "time", "P1", "--bound", "kp=1"), ["kp", "LOW,HIGH"]),
        (("tune", "time", "P1", "--start", "1,2"), ["'1,2'", "KP,KI,KD,LAM,MU"]),
        (("tune", "rule", "P1", "--rule", "best"), ["rule", "'best'", "fmigo"]),
        (("tune", "time", "1/(s+", "--json"), ["1/(s+"]),
    ],
)
def test_bad_input_leaves_with_2_and_one_line(arguments: tuple[str, ...], words: list[str]) -> None:
    result = run(*arguments)
    assert result.exit_code == 2
    assert result.stdout == ""
    assert len(result.stderr.splitlines()) == 1
    assert all(word in result.stderr for word in words), result.stderr


def test_without_json_people_get_tables() -> None:
    text = run("tune", "rule", "P1", "--rule", "amigo-pi").stdout
    for word in ("Gains", "kp", "Achieved", "ms", "Tuning", "success"):
        assert word in text
    assert "Preferred" in run("reduce", "P3").stdout


def test_the_papers_processes_reduce_to_errors_at_most_the_best_known() -> None:
    known = {(row["process"], row["template"]): row["best_known_H2_error"] for row in paper_tables()["table1_table2"]}
    (model,) = answer("reduce", "P4", "--template", "nioptd2")["models"]
    assert model["h2_error"] <= 1.01 * known["P4", "NIOPTD-II"]


def test_a_tuning_shows_what_steps_do_before_and_after(tmp_path: Path) -> None:
    before, picture = "0.68,0.29,0,1,1", tmp_path / "steps.png"
    found = answer("tune", "rule", "P1", "--rule", "simc-pi", "--before", before, "--plot", str(picture))
    assert found["before"]["gains"] == {"kp": 0.68, "ki": 0.29, "kd": 0.0, "lam": 1.0, "mu": 1.0}
    for gains, steps in (
        (before, found["before"]["steps"]),
        (",".join(str(value) for value in found["gains"].values()), found["steps"]),
    ):
        judged = answer("evaluate", "P1", "--gains", gains, "--horizon", str(steps["horizon"]))
        for name in ("overshoot_pct", "rise_time", "settling_time", "ms", "mt"):
            assert steps[name] == pytest.approx(judged[name], rel=1e-3, abs=1e-6), name
        assert steps["iae_setpoint"] == pytest.approx(judged["indices"]["iae"], rel=1e-3)
    assert found["plot"] == str(picture)
    assert picture.stat().st_size > 5000


def test_people_see_before_and_after_in_one_row_with_its_unit() -> None:
    told = run("tune", "rule", "P1", "--rule", "simc-pi", "--before", "0.68,0.29,0,1,1").stdout
    assert re.search(r"settling_time +12\.\d+ -> [\d.]+ s$", told, re.MULTILINE)
    assert re.search(r"kp +0\.68 -> 1\.7409$", told, re.MULTILINE)
    assert re.search(r"crossover +0\.7311 rad/s$", told, re.MULTILINE)


def test_gains_before_that_are_not_stable_are_told_as_such() -> None:
    found = answer("tune", "rule", "P1", "--rule", "simc-pi", "--before", "9,0,0,1,1")
    assert found["before"]["steps"]["stable"] is False
    assert found["before"]["steps"]["iae_setpoint"] is None
    assert found["steps"]["stable"] is True


def recorded(folder: Path) -> Path:
    """A step test of 2/(10s+1)exp(-3s) with a sample each second, as a csv file."""
    record = step_record("2/(10s+1)*exp(-3s)", 150.0, 1.0, 0.02)
    table = np.column_stack([record.time, record.control, record.measurement])
    np.savetxt(folder / "step.csv", table, delimiter=",", header="time,control,measurement", comments="")
    return folder / "step.csv"


def test_a_record_in_place_of_a_process_gives_its_sample_time_and_noise(tmp_path: Path) -> None:
    line = ("tune", "frequency", "--record", str(recorded(tmp_path)), "--template", "foptd")
    found = answer(*line, "--control-min", "-1", "--control-max", "4")
    assert found["success"]
    assert found["record"]["template"] == "foptd"
    assert found["record"]["noise"] == pytest.approx(0.02, rel=0.1)
    assert found["record"]["taken"].keys() == {"sample_time", "u_max"}
    assert "1 % of the range 5" in found["message"]


def test_limits_and_rate_are_those_of_a_bags_controller(tmp_path: Path) -> None:
    recording = Recording(tmp_path / "bag", StoragePlugin.MCAP)
    record_loop(recording)
    recording.writer.set_custom_data("experiment", EXPERIMENT)
    recording.writer.close()
    found = read_record(tmp_path / "bag")
    assert (found.control_min, found.control_max, found.control_rate_max) == (-10.0, 10.0, math.inf)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ((), "allowed: PROCESS or --record FILE"),
        (("P1", "--record", "step.csv"), "beside --record; allowed: one of them"),
        (("P1", "--control-max", "3"), "control-max without a record"),
        (("--record", "none.csv"), "none.csv"),
    ],
    ids=("neither", "both", "limits alone", "no file"),
)
def test_a_process_or_a_record_is_asked_for(options: tuple[str, ...], said: str) -> None:
    result = run("tune", "frequency", *options)
    assert (result.exit_code, len(result.stderr.splitlines())) == (2, 1)
    assert said in result.stderr


def test_a_record_that_tells_nothing_leaves_with_3(tmp_path: Path) -> None:
    rows = "\n".join(f"{k},1,{k % 3}" for k in range(60))
    (tmp_path / "still.csv").write_text(f"time,control,measurement\n{rows}\n")
    found = answer("tune", "time", "--record", str(tmp_path / "still.csv"), status=3)
    assert (found["success"], found["gains"]) == (False, None)
