"""Every verb of the command line does its work, as a process of its own, with the libraries that are installed.

`make test-jazzy` runs these lines with the libraries of Ubuntu 24.04.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin

from fopid_core.cli.main import main

from ..study.days import write_day
from ..study.recording import Recording, record_loop

pytestmark = pytest.mark.slow

FOPID = Path(sys.executable).with_name("fopid")
SCHEDULE = Path(__file__).parents[3] / "config" / "schedules" / "tank.yaml"
GAINS = "0.9,0.25,0.2,1.15,1"
CAMPAIGN = """\
name: small
processes: [P1]
variations: {gain: {low: 0.5, high: 2}, samples: 10}
designs:
  - {name: ours, method: frequency, phase_margin_deg: 80, crossover: 0.3}
figure: [ms, itae]
"""
EXPERIMENT = """\
name: small
process: P1
gains: {kp: 1, ki: 0.25}
phases:
  - {name: step, duration: 10, setpoint: 1}
  - {name: tuned, duration: 10, tune: {method: time, index: itae}}
"""
LINES = (
    "reduce P2",
    "tune frequency P1 --phase-margin 80 --crossover 0.3",
    "tune time 2/(s+1)^3*exp(-0.2s) --index itae --ms-max 1.6",
    "tune rule P3 --rule fmigo",
    "tune frequency --record record.csv",
    "tune time --record record.csv --structure pi --template foptd",
    f"evaluate P1 --gains {GAINS}",
    f"evaluate process.yaml --gains {GAINS} --method gl1",
    f"step P1 --gains {GAINS} --plot step.png",
    f"certify P1 --gains {GAINS} --ms-max 4",
    "region P1 --orders 1,1 --points 20 --plot region.pdf",
    "identify record.csv --template foptd",
    "design record.csv --columns measurement,control",
    "replay day.csv --gains 0.5,0.5,0,1,1 --plot replay.png --out replay.csv",
    "identify mcap --template foptd",
    "identify sqlite3 --template foptd",
    f"export --gains {GAINS} --out c",
    "simulate experiment.yaml --out simulated",
    "simulate experiment.yaml --replay mcap",
    "report mcap --figures figures",
    "report sqlite3",
    "repair mcap",
    "campaign campaign.yaml --workers 1",
    "compare 1/(s+1)*exp(-0.5s)",
    "front 1/(s+1)*exp(-0.5s) --structure pi --points 20 --plot front.png --csv front.csv --take 3",
    "limit 1/(s+1)*exp(-0.5s) --cells 60",
    f"schedule {SCHEDULE}",
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the lines read."""
    made = tmp_path_factory.mktemp("verbs")
    for name, storage in (("mcap", StoragePlugin.MCAP), ("sqlite3", StoragePlugin.SQLITE3)):
        recording = Recording(made / name, storage)
        record_loop(recording)
        recording.writer.close()
    time = np.arange(0.0, 40.0, 0.05)
    output = 2.0 * -np.expm1(-np.maximum(time - 1.0, 0.0) / 3.0)
    table = np.column_stack([time, time >= 0.0, output])
    table[0, 1] = 0.0
    np.savetxt(made / "record.csv", table, delimiter=",", header="time,control,measurement", comments="")
    write_day(made / "day.csv")
    (made / "process.yaml").write_text("process: 1/(s+1)^3\n")
    (made / "campaign.yaml").write_text(CAMPAIGN)
    (made / "experiment.yaml").write_text(EXPERIMENT)
    return made


def test_every_verb_has_its_line() -> None:
    """All but three with tests of their own: ``benchmark`` measures its machine, ``explore`` does not end,
    ``reproduce`` takes the longest (test_reproduction.py).
    """
    assert {line.split()[0] for line in LINES} | {"benchmark", "explore", "reproduce"} == set(main.commands)


@pytest.mark.timeout(900)
@pytest.mark.parametrize("line", LINES)
def test_the_verb_does_its_work_and_says_nothing_on_stderr(folder: Path, line: str) -> None:
    done = subprocess.run([FOPID, *line.split(), "--json"], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)
    told = [text for text in done.stderr.splitlines() if not text.startswith("10 of 11 runs")]
    assert not [text for text in told if "runs" not in text], done.stderr


@pytest.mark.parametrize(
    ("line", "gains", "cost"),
    [
        ("tune frequency P1 --crossover 0.3 --phase-margin 80",
         (0.120156, 0.467349, 1.193546, 0.887598, 0.571582), 1.165051),
        ("tune time P2 --index itae --ms-max 1.6", (0.855703, 1.326934, 0.146992, 1.0, 1.0), 0.779485),
        ("tune time 2/(s+1)^3*exp(-0.2s) --index iae", (0.367992, 0.363994, 0.743970, 0.973499, 0.519783), 1.920649),
    ],
)  # fmt: skip
def test_a_tuning_is_the_same_with_old_and_new_libraries(
    folder: Path, line: str, gains: tuple[float, ...], cost: float
) -> None:
    """The cost is flat about its minimum: 1e-5 of it are some 1e-3 of the gains."""
    done = subprocess.run([FOPID, *line.split(), "--json"], cwd=folder, capture_output=True, text=True, check=True)
    found = json.loads(done.stdout)
    assert found["cost"] == pytest.approx(cost, rel=1e-5)
    assert list(found["gains"].values()) == pytest.approx(gains, rel=5e-3)
