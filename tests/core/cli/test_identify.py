"""``fopid identify`` reads csv files and bags and keeps the contract: JSON keys, exit status, one-line errors."""

from __future__ import annotations

import json
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import Result
from rosbags.rosbag2 import StoragePlugin

from fopid_core.design.identification.record import Record
from fopid_core.design.sampled_loop import sampled_process
from fopid_core.model.process import read_process
from fopid_core.study.records import read_record

from ..design.identification.recorded import step_record
from ..study.recording import Recording, record_loop
from .runner import invoke


def run(*arguments: object) -> Result:
    return invoke(["identify", *map(str, arguments)])


def answer(*arguments: object, status: int = 0) -> dict[str, Any]:
    result = run(*arguments, "--json")
    assert (result.exit_code, result.stderr) == (status, "")
    found: dict[str, Any] = json.loads(result.stdout)
    return found


def written(record: Record, path: Path) -> Path:
    columns = np.column_stack([record.time, record.control, record.measurement])
    np.savetxt(path, columns, delimiter=",", header="time,control,measurement", comments="", fmt="%.12g")
    return path


def test_a_csv_file_is_identified(tmp_path: Path) -> None:
    found = answer(written(step_record("3/(2s+1)*exp(-0.7s)", 20.0, 0.05, noise=0.02), tmp_path / "step.csv"))
    assert found["success"]
    assert found["template"] == "foptd"
    assert [model["template"] for model in found["models"]] == ["foptd", "nioptd1", "soptd", "nioptd2"]
    first = found["models"][0]
    assert first["parameters"] == pytest.approx({"K": 3.0, "T": 2.0, "L": 0.7}, rel=0.02)
    assert set(first["deviations"]) == {"K", "T", "L"}
    assert found["fit_pct"] == first["fit_pct"] > 97.0


def test_one_template_can_be_asked_for_and_people_see_a_table(tmp_path: Path) -> None:
    path = written(step_record("P1", 20.0, 0.05), tmp_path / "step.csv")
    assert [model["template"] for model in answer(path, "--template", "rational:3")["models"]] == ["rational:3"]
    assert "fit on held-back samples" in run(path, "--template", "foptd").stdout


def test_the_frequency_response_without_a_model_stands_beside_the_fit(tmp_path: Path) -> None:
    path = written(step_record("3/(2s+1)*exp(-0.7s)", 40.0, 0.1, noise=0.02), tmp_path / "step.csv")
    found = answer(path, "--template", "foptd")
    response = found["frequency_response"]
    assert response["sample_time"] == pytest.approx(0.1)
    points = response["points"]
    assert len(points) > 5
    assert len(points) + len(response["not_known"]) == 24
    held = sampled_process(read_process("3/(2s+1)*exp(-0.7s)"), 0.1, 0.1 * np.array([p["frequency"] for p in points]))
    inside = [abs(p["real"] + 1j * p["imag"] - true) <= p["radius"] for p, true in zip(points, held, strict=True)]
    assert np.mean(inside) > 0.7
    assert np.mean([p["model_outside"] for p in points]) < 0.3
    assert "without a model" in run(path, "--template", "foptd").stdout


def test_a_record_without_information_ends_with_status_3_and_advice(tmp_path: Path) -> None:
    path = written(step_record("P1", 20.0, 0.05), tmp_path / "step.csv")
    found = answer(path, "--to", "3", status=3)
    assert not found["success"]
    assert "move" in found["message"]


def test_a_bag_is_identified(tmp_path: Path) -> None:
    recording = Recording(tmp_path / "bag", StoragePlugin.MCAP)
    record_loop(recording)
    recording.writer.close()
    found = answer(tmp_path / "bag", "--template", "rational:3", "--to", "30")
    # the plant is 1/(s+1)^3 without noise, and starts with a setpoint step
    assert found["models"][0]["parameters"] == pytest.approx(
        {"b0": 1.0, "a1": 3.0, "a2": 3.0, "a3": 1.0, "L": 0.0}, rel=0.02, abs=0.01
    )


@pytest.mark.parametrize(
    ("header", "order", "separator", "mark", "encoding"),
    [
        ("measurement,time,control", (2, 0, 1), ",", ".", "utf-8"),
        ("Time [s],Control (V),Measurement [degC]", (0, 1, 2), ",", ".", "utf-8-sig"),
        ("time;control;measurement", (0, 1, 2), ";", ",", "utf-8"),
        ("time\tcontrol\tmeasurement", (0, 1, 2), "\t", ".", "utf-8"),
        ("time\tcontrol\tmeasurement [°C]", (0, 1, 2), "\t", ".", "utf-16"),
        ("time;control;measurement [°C]", (0, 1, 2), ";", ",", "cp1252"),
    ],
)
def test_spreadsheets_write_csv_in_many_ways(
    header: str, order: tuple[int, ...], separator: str, mark: str, encoding: str, tmp_path: Path
) -> None:
    rows = [(0.1 * k, float(k > 5), 0.01 * k) for k in range(40)]
    lines = [separator.join(f"{row[i]:.6f}".replace(".", mark) for i in order) for row in rows]
    path = tmp_path / "record.csv"
    path.write_bytes("\r\n".join([header, *lines]).encode(encoding))
    record = read_record(path)
    assert np.column_stack([record.time, record.control, record.measurement]) == pytest.approx(np.array(rows))


@pytest.mark.parametrize(
    ("first", "step", "seconds"),
    [
        ("46000.5", 1.0 / 1440.0, 60.0),  # a spreadsheet's days
        ("46000.5", 5.0 / 1440.0, 300.0),
        ("46000.5", 1.0 / 24.0, 3600.0),
        ("46000.5", 0.01, 0.01),  # a clock that has run for half a day
        ("46000.5", 1.0 / 60.0, 1.0 / 60.0),
        ("46000.5", 1.0 / 128.0, 1.0 / 128.0),
        ("134000000000000000", 1e7, 1.0),  # since 1601, and since the year 1, in 100 ns
        ("639000000000000000", 1e7, 1.0),
        ("1800000000000000000", 1e9, 1.0),
    ],
)
def test_numbers_that_tell_a_date_are_in_its_unit(first: str, step: float, seconds: float, tmp_path: Path) -> None:
    times = [f"{float(first) + k * step:.8f}" if "." in first else str(int(first) + round(k * step)) for k in range(40)]
    path = tmp_path / "record.csv"
    path.write_text("\n".join(["time,control,measurement", *(f"{t},{k > 5:d},{k}" for k, t in enumerate(times))]))
    assert read_record(path).sample_time == pytest.approx(seconds, rel=1e-3)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "allowed: a first line with time, control, measurement"),
        ("time,u,y\n0,0,0\n", "columns time, u, y of"),
        ("time,control,measurement\n0,0,0\n1,x,0\n", "control = 'x' in data row 2; allowed: a number"),
        ("time [week],control,measurement\n0,0,0\n", "time in week; allowed: s, sec, secs, second"),
        ("time,control,measurement\nnoon,0,0\n", "time = 'noon' in data row 1; allowed: seconds, or a time as 2026"),
        ("time,control,control,measurement\n0,0,0,0\n", "allowed: control once"),
        ("time,control,measurement\n0,5,0,1,2\n", "5 cells in data row 1; allowed: one for each of 3 columns"),
        ("time,control,measurement\n0,0,0\n", "record of 1 samples; allowed: 30 or more"),
    ],
)
def test_a_file_that_cannot_be_used_is_named_in_one_line(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "record.csv"
    path.write_text(text)
    result = run(path)
    assert result.exit_code == 2
    assert said in result.stderr
    assert len(result.stderr.splitlines()) == 1


def test_a_file_that_is_no_text_is_named(tmp_path: Path) -> None:
    path = tmp_path / "record.csv"
    path.write_bytes(b"\x89PNG\r\n\x1a\n\0\0")
    result = run(path)
    assert result.exit_code == 2
    assert "record.csv' is no text; allowed: csv in UTF-8, UTF-16 or Windows-1252" in result.stderr


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    result = run(tmp_path / "none.csv")
    assert result.exit_code == 2
    assert "none.csv" in result.stderr


ROWS = [(0.5 * k, float(k > 5), 0.25 * k) for k in range(40)]


def on_the_clock(began: str, clock: str) -> list[str]:
    """The rows with the times of a clock."""
    first = datetime.fromisoformat(began)
    return [f"{first + timedelta(seconds=t):{clock}},{u},{y}" for t, u, y in ROWS]


@pytest.mark.parametrize(
    ("lines", "columns"),
    [
        ([f"{t},{u},{y}" for t, u, y in ROWS], None),  # no header
        (["t,OP,PV", *(f"{t},{u},{y}" for t, u, y in ROWS)], None),
        (["Time [ms],OP (%),PV (degC)", *(f"{1000 * t},{u},{y}" for t, u, y in ROWS)], None),
        (["time,control,measurement", "min,%,degC", *(f"{t / 60},{u},{y}" for t, u, y in ROWS)], None),
        (["tag,FIC1.OP,TI1", *(f"{t},{u},{y}" for t, u, y in ROWS)], "TI1,FIC1.OP"),
        (["a,b,c", *(f"{y},{t},{u}" for t, u, y in ROWS)], "1,3,3,2"),
        (["time,op,pv", *(f"2026-01-31T23:59:{t:04.1f}00Z,{u},{y}" for t, u, y in ROWS)], None),
        (["time,op,pv", *(f"2026-01-31 23:59:{t:04.1f}00,{u},{y}" for t, u, y in ROWS)], None),
        (["time,op,pv", *(f"{1.7e9 + t},{u},{y}" for t, u, y in ROWS)], None),
        (["time [minutes],op,pv", *(f"{t / 60.0!r},{u},{y}" for t, u, y in ROWS)], None),
        (["time,op,pv", *(f"{46_000.0 + t / 86_400.0:.12f},{u},{y}" for t, u, y in ROWS)], None),
        (["time,op,pv", *(f"{1.7e12 + 1000 * t:.0f},{u},{y}" for t, u, y in ROWS)], None),
        (["time;op;pv", *(f"{t};{u};{y}".replace(".", ",") for t, u, y in ROWS)], None),
        (["time,op,pv", *(f"{t},{u},{y}\n{t + 0.1},,{y}" for t, u, y in ROWS)], None),  # gaps
        (["time,op,pv", *(f"{t},{u},{y}\n{t + 0.1},{u},Bad\n{t + 0.2},#N/A,{y}" for t, u, y in ROWS)], None),
        (["time;op;pv", *(f"31.01.2026 23:59:{t:04.1f};{u};{y}" for t, u, y in ROWS)], None),
        (["time,op,pv", *(f"01/31/2026 11:59:{2 * t:02.0f} PM,{u},{2 * y}" for t, u, y in ROWS)], "pv,op"),
        (["time,op,pv", *(f"23:59:{t:04.1f},{u},{y}" for t, u, y in ROWS)], None),
        (["time,op,pv", *on_the_clock("2026-01-31 23:59:50", "%H:%M:%S.%f")], None),
        (["time,op,pv", *on_the_clock("2026-01-31 13:00:00", "%m/%d/%Y %H:%M:%S.%f")], None),
        (["time,op,pv", *on_the_clock("2026-04-03 23:59:50", "%m/%d/%Y %H:%M:%S.%f")], None),
        (["time,op,pv", *on_the_clock("2026-04-03 23:59:50", "%d/%m/%Y %H:%M:%S.%f")], None),
        (["time [ms],op,pv", *(f"{123456000 + 1000 * t},{u},{y}" for t, u, y in ROWS)], None),
        (["time [ns],op,pv", *(f"{5000000000 + 1e9 * t:.0f},{u},{y}" for t, u, y in ROWS)], None),
        (["Logger 7, of 3", "", "site: boiler", "time,MV,PV", *(f"{t},{u},{y}" for t, u, y in ROWS)], None),
        (["# made by hand", "Tag,TIC7.OUT,TIC7.IN", *(f"{t},{u},{y}" for t, u, y in ROWS)], "TIC7.IN,TIC7.OUT"),
    ],
    ids=(
        "no header",
        "PV",
        "ms",
        "row of units",
        "tags",
        "numbers",
        "ISO",
        "ISO, blank",
        "epoch",
        "minutes",
        "spreadsheet",
        "epoch ms",
        "comma",
        "gaps",
        "bad values",
        "day first",
        "am or pm",
        "time of day",
        "over midnight",
        "month first, 24 hours",
        "month or day first, over midnight",
        "day or month first, over midnight",
        "ms since the start",
        "ns since the start",
        "lines before the header",
        "lines before the header, tags",
    ),
)
def test_control_systems_write_csv_in_many_ways(lines: list[str], columns: str | None, tmp_path: Path) -> None:
    path = tmp_path / "record.csv"
    path.write_text("\n".join(lines))
    record = read_record(path, columns=columns)
    twice = 2.0 if " PM" in lines[-1] else 1.0  # these have no fractions of seconds
    found = np.column_stack([record.time / twice, record.control, record.measurement / twice])
    assert found == pytest.approx(np.array(ROWS), abs=1e-6)
    assert record.left_out == lines[-1].count("\n") * 40


def test_two_tests_with_a_weekend_between_are_not_one_of_sixty_hours(tmp_path: Path) -> None:
    """Sampled by the hour the process had 37 s of delay instead of 8, and the answer was a success."""
    one = step_record("1.8/(40s+1)*exp(-8s)", 600.0, 1.0, noise=0.05)
    two = step_record("1.8/(40s+1)*exp(-8s)", 500.0, 1.0, noise=0.05)
    joined = [np.concatenate([getattr(one, name), getattr(two, name)]) for name in ("control", "measurement")]
    path = written(Record(np.append(one.time, two.time + 216_000.0), *joined), tmp_path / "weekend.csv")
    found = answer(path)
    assert found["success"]
    assert f"of {joined[0].size} samples the {one.time.size} from 0 s to 599 s, a stretch" in found["message"]
    assert read_process(found["process"]).delay == pytest.approx(8.0, abs=0.5)


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ("c,a", "column 'c'"),
        ("c,a", "one of time, a, b"),
        ("a,a", "one column as measurement and control; allowed: two"),
    ],
)
def test_columns_that_cannot_be_used_are_named(columns: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "record.csv"
    path.write_text("time,a,b\n0,0,0\n")
    result = run(path, "--columns", columns)
    assert result.exit_code == 2
    assert said in result.stderr


def test_the_fit_is_drawn(tmp_path: Path) -> None:
    path = written(step_record("3/(2s+1)*exp(-0.7s)", 20.0, 0.05, noise=0.02), tmp_path / "step.csv")
    assert answer(path, "--template", "foptd", "--plot", tmp_path / "fit.png")["plot"]
    assert (tmp_path / "fit.png").stat().st_size > 10_000
