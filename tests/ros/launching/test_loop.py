"""What a loop is started with, by what somebody says: one meaning of ``process`` in every launch file."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
import yaml

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import read_process
from fopid_core.model.stability import stability
from fopid_ros.launching.loop import EXECUTABLES, loop_parameters

GAINS = ("kp", "ki", "kd", "lam", "mu")


@pytest.mark.parametrize("text", ["2/(s+1)^3", "9/((s+1)(s^2+2s+9))", "3.13/(433.33s+1)*exp(-50s)", "-2/(s+1)^2"])
def test_any_process_gets_gains_that_hold_it(text: str) -> None:
    parameters = loop_parameters(text, "")
    assert [own["process"] for name in ("plant_simulator", "fopid_tuner") for own in parameters[name]] == [text] * 2
    (controller,) = parameters["fopid_controller"]
    assert controller["kp"] != 0.0 != controller["ki"]
    assert stability(Loop(read_process(text), Fopid(*(controller[name] for name in GAINS)))).stable
    assert len({own[-1]["sample_time"] for own in parameters.values()}) == 1


@pytest.mark.parametrize("process", ["", "P1", "P2", "P3", "P4"])
def test_the_test_bench_has_parameter_files_of_its_own(process: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AMENT_PREFIX_PATH", sys.prefix)
    files = {tuple(own) for own in loop_parameters(process, "").values()}
    ((file,),) = files
    assert Path(file).name == f"{process or 'P1'}.yaml"
    assert set(yaml.safe_load(Path(file).read_text())) == {f"/**/{name}" for name in EXECUTABLES}


def test_a_file_comes_first_and_a_process_beside_it_counts_for_plant_and_tuner(tmp_path: Path) -> None:
    file = tmp_path / "gains.yaml"
    file.touch()
    assert set(map(tuple, loop_parameters("", str(file)).values())) == {(str(file),)}
    parameters = loop_parameters("1/(s+1)", str(file))
    assert parameters["fopid_controller"] == [str(file)]
    assert parameters["plant_simulator"] == parameters["fopid_tuner"] == [str(file), {"process": "1/(s+1)"}]


@pytest.mark.parametrize(
    ("process", "params_file", "told"),
    [
        ("1/(s+x)", "", "character 6"),
        ("1/s^2", "", "no stable PI to start with"),
        ("1/(0.001s+1)^2", "", "needs a sample every 4e-06 s; allowed: 0.001 s and more"),
        ("P5", "", "'P5'"),
        ("P1", "/no/such.yaml", "params_file = '/no/such.yaml'; allowed: the path of a file that exists"),
    ],
)
def test_what_cannot_be_started_is_said(process: str, params_file: str, told: str) -> None:
    with pytest.raises(InputError) as refused:
        loop_parameters(process, params_file)
    assert told in str(refused.value)
