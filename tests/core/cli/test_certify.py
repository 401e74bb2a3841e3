"""``fopid certify`` keeps the contract: its keys, its exit status, and files that it checks again."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import Result

from .runner import invoke

GAINS = ("--gains", "2.9692,0.8028,1.3394,1.0138,0.6074")


def run(*arguments: str) -> Result:
    return invoke(["certify", *arguments])


def answer(*arguments: str, status: int = 0) -> dict[str, Any]:
    result = run(*arguments, "--json")
    assert (result.exit_code, result.stderr) == (status, "")
    found: dict[str, Any] = json.loads(result.stdout)
    return found


def test_a_proof_is_written_and_checked(tmp_path: Path) -> None:
    path = tmp_path / "proof.json"
    found = answer("P1", *GAINS, "--ms-max", "2.2", "--mt-max", "1.7", "--noise-max", "60", "--out", str(path))
    assert found.keys() >= {"certified", "claims", "reason", "elapsed_s"}
    assert found["certified"] is True
    assert found["claims"]["ms_max"] == 2.2
    checked = answer("--check", str(path))
    assert (checked["accepted"], checked["claims"]["ms_max"]) == (True, 2.2)


@pytest.mark.parametrize(
    ("old", "new"), [("2.2", "2.1"), ("2.9692", "2.9693"), ("true", "false"), ("{", "["), ("}", "")]
)
def test_a_changed_file_is_not_accepted(tmp_path: Path, old: str, new: str) -> None:
    path = tmp_path / "proof.json"
    answer("P1", *GAINS, "--ms-max", "2.2", "--out", str(path))
    path.write_text(path.read_text().replace(old, new))
    assert answer("--check", str(path), status=3)["accepted"] is False


def test_bytes_that_are_no_text_are_not_accepted(tmp_path: Path) -> None:
    path = tmp_path / "proof.json"
    path.write_bytes(b"\xff\xfe\x00{")
    assert answer("--check", str(path), status=3)["accepted"] is False


def test_what_is_false_is_refuted_and_nothing_written(tmp_path: Path) -> None:
    path = tmp_path / "proof.json"
    found = answer("P1", "--gains", "9,0,0,1,1", "--out", str(path), status=3)
    assert (found["certified"], found["reason"]) == (False, "unstable: 2 poles in the right half-plane")
    assert not path.exists()


def test_what_is_not_known_is_null() -> None:
    found = answer("1/(s+1)^3", "--gains", "8,0,0,1,1", status=3)
    assert found["certified"] is None
    assert "too near" in found["reason"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "certify without PROCESS and --gains"),
        (("P1",), "certify without PROCESS and --gains"),
        (("P1", *GAINS, "--ms-max", "0.9"), "ms-max = 0.9; allowed: a finite number above 1"),
        (("P1", *GAINS, "--precision", "4"), "precision = 4; allowed: 53 to 4096 bits"),
        (("--check", "no such file"), "'no such file' cannot be read"),
    ],
)
def test_bad_input_is_one_line(arguments: tuple[str, ...], said: str) -> None:
    result = run(*arguments)
    assert result.exit_code == 2
    assert said in result.stderr
    assert len(result.stderr.splitlines()) == 1


def test_a_box_is_certified_or_a_member_that_fails_is_named() -> None:
    gains = ("--gains", "1,1,0.2,1,1", "--ms-max", "2")
    found = answer("K/(T*s+1)*exp(-0.25s)", *gains, "--box", "K=0.8,1.2", "--box", "T=0.8,1.2")
    assert (found["certified"], found["certified_share"], found["counterexample"]) == (True, 1.0, None)
    found = answer("1/(s+1)*exp(-0.25s)", *gains, "--box", "K=0.8,4", status=3)
    assert found["certified"] is False
    assert 0.1 < found["certified_share"] < 0.9
    assert found["certified_share"] + found["failed_share"] > 0.9
    assert found["counterexample"]["K"] > 1.2


@pytest.mark.parametrize("box", ["K", "K=1", "K=1,x", "K=2,1", "s=1,2", "T=1,nan"])
def test_a_box_that_cannot_be_used_is_named(box: str) -> None:
    result = run("K/(s+1)", "--gains", "1,1,0,1,1", "--box", box)
    assert (result.exit_code, len(result.stderr.splitlines())) == (2, 1)
    assert "box" in result.stderr


def test_a_tuning_comes_with_its_certificate() -> None:
    result = invoke(["tune", "rule", "2/(3s+1)*exp(-0.5s)", "--rule", "simc-pi", "--certify", "--json"])
    found = json.loads(result.stdout)
    assert (result.exit_code, found["certificate"]["certified"]) == (0, True)


def test_what_is_proved_of_a_filtered_measurement_is_what_a_dense_grid_shows() -> None:
    s = 1j * np.logspace(-3, 3, 400_001)
    filtered = (1.0 + 0.4 / s + 0.5 * s) / ((1.0 + 0.3 * s + 0.5 * (0.3 * s) ** 2) * (s + 1.0) ** 3)
    ms = float(np.abs(1.0 / (1.0 + filtered)).max())
    loop = ("P1", "--gains", "1,0.4,0.5,1,1", "--filter", "2,0.3", "--ms-max")
    assert answer(*loop, f"{1.0001 * ms}")["certified"] is True
    assert answer(*loop, f"{0.9999 * ms}", status=3)["certified"] is False


def test_a_bound_on_noise_is_not_proved_of_a_filtered_measurement_and_that_is_said() -> None:
    result = run("P1", *GAINS, "--filter", "2,0.3", "--noise-max", "9")
    assert (result.exit_code, result.stderr.count("\n")) == (2, 1)
    assert "noise-max" in result.stderr
