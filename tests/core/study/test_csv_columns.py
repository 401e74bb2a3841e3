"""A record is the same however it was written, or it is refused with what to change; never another one."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from fopid_core.errors import InputError
from fopid_core.study.csv_columns import read_csv_signals

BEGAN = datetime(2026, 3, 28, 23, 0)
SETPOINT = np.repeat([80.0, 84.0, 79.0, 79.5], 10)
MEASUREMENT = np.round(SETPOINT + 0.5 * np.sin(np.arange(40.0)) + 0.04, 2)
CONTROL = np.round(50.0 - 0.3 * np.cos(np.arange(40.0)), 2)
HEADER = "time,control,measurement,setpoint"
Row = Callable[[int], str]


def when(form: str) -> Row:
    """Each row with its time, a minute apart."""
    return lambda k: f"{(BEGAN + timedelta(minutes=k)).strftime(form)},{CONTROL[k]},{MEASUREMENT[k]},{SETPOINT[k]}"


def number(each: Callable[[int], object]) -> Row:
    return lambda k: f"{each(k)},{CONTROL[k]},{MEASUREMENT[k]},{SETPOINT[k]}"


def comma(row: Row) -> Row:
    return lambda k: row(k).replace(",", ";").replace(".", ",")


def lines(row: Row, header: str = HEADER) -> list[str]:
    return [header, *map(row, range(40))]


SECONDS = number(lambda k: 60 * k)
WRITTEN: dict[str, list[str]] = {
    "seconds": lines(SECONDS),
    "minutes": lines(number(int), "Time in min,OP,PV,SP"),
    "minutes too": lines(number(int), "elapsed_min,MV,PV,SV"),
    "hours": lines(number(lambda k: k / 60), "time/h,OP,PV,Set Point"),
    "a historian's": lines(when("%d-%b-%y %H:%M:%S")),
    "its years in full": lines(when("%d-%b-%Y %H:%M:%S")),
    "a spreadsheet's": lines(when("%m/%d/%Y %H:%M")),
    "slashes, years first": lines(when("%Y/%m/%d %H:%M:%S")),
    "years of two digits": lines(when("%m/%d/%y %H:%M:%S")),
    "morning and afternoon": lines(when("%I:%M:%S %p")),
    "of the day": lines(when("%H:%M")),
    "of a zone": lines(when("%Y-%m-%d %H:%M:%S CET")),
    "digits": lines(when("%Y%m%d%H%M%S")),
    "days since 1900": lines(number(lambda k: f"{46109.0 + k / 1440:.8f}")),
    "days since the year 0": lines(number(lambda k: f"{740069.0 + k / 1440:.8f}")),
    "universal time": lines(number(lambda k: 1_774_738_800 + 60 * k), "Time (UTC),OP,PV,SP"),
    "newest first": [HEADER, *reversed(lines(SECONDS)[1:])],
    "newest first, by the clock": [HEADER, *reversed(lines(when("%Y-%m-%d %H:%M:%S"))[1:])],
    "twice": [HEADER, *(line for line in lines(SECONDS)[1:] for _ in range(2))],
    "bars": [line.replace(",", "|") for line in lines(SECONDS)],
    "comments": ["# exported by hand", *lines(SECONDS)],
    "a comma at each end": [HEADER, *(f"{line}," for line in lines(SECONDS)[1:])],
    "per cent": lines(lambda k: SECONDS(k).replace(f",{CONTROL[k]},", f",{CONTROL[k]} %,"), "time,control %,PV,SP"),
    "decimal commas, quoted": lines(lambda k: '"' + comma(SECONDS)(k).replace(";", '","') + '"'),
    "a setpoint where it changes": lines(lambda k: SECONDS(k) if k % 10 == 0 else f"{SECONDS(k).rpartition(',')[0]},"),
    "tags merged": [HEADER, *(line for k in range(40) for line in (
        f"{60 * k - 2},{CONTROL[k]},,", f"{60 * k - 1},,,{SETPOINT[k]}", f"{60 * k},,{MEASUREMENT[k]},"))],
}  # fmt: skip
GERMAN = lines(lambda k: comma(SECONDS)(k).replace(f"{60 * k};", f"{when('%d.%m.%Y %H:%M')(k).partition(',')[0]};", 1))
WRITTEN["a spreadsheet's in German"] = [line.replace(HEADER, HEADER.replace(",", ";")) for line in GERMAN]


def read(content: list[str], path: Path, columns: str | None = None, encoding: str = "utf-8") -> dict[str, np.ndarray]:
    path.write_text("\n".join(content) + "\n", encoding=encoding)
    return read_csv_signals(path, columns).values


@pytest.mark.parametrize("written", WRITTEN)
def test_it_is_the_same_however_it_was_written(written: str, tmp_path: Path) -> None:
    found = read(WRITTEN[written], tmp_path / "record.csv")
    assert np.allclose(found["time"] - found["time"][0], 60.0 * np.arange(40), atol=0.01)
    assert np.allclose(found["control"], CONTROL)
    assert np.allclose(found["measurement"], MEASUREMENT)
    assert np.allclose(found["setpoint"], SETPOINT)


def test_a_limit_is_no_control_in_minutes(tmp_path: Path) -> None:
    found = read(lines(lambda k: f"{SECONDS(k)},10", "time,op,pv,sp,op_min"), tmp_path / "record.csv")
    assert np.allclose(found["control"], CONTROL)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "cp1252"])
def test_in_any_encoding(encoding: str, tmp_path: Path) -> None:
    content = lines(SECONDS, "Zeit [s],Stellgröße [%],Istwert [°C],Sollwert [°C]")
    found = read(content, tmp_path / "record.csv", encoding=encoding)
    assert np.allclose(found["measurement"], MEASUREMENT)


@pytest.mark.parametrize("mark", [",", ".", "'"])
@pytest.mark.parametrize("factor", [12.2, 1220.0])
def test_thousands_are_no_decimals(mark: str, factor: float, tmp_path: Path) -> None:
    """A flow of 97,565 beside an opening of 50.04 % was read as 97.565: the gains were a thousand times too large."""
    point = "," if mark == "." else "."

    def row(k: int) -> str:
        opening, flow = f"{CONTROL[k]}".replace(".", point), f"{MEASUREMENT[k] * factor:,.0f}".replace(",", mark)
        return f"{60 * k}\t{opening}\t{flow}"

    found = read(lines(row, "time\tcontrol\tmeasurement"), tmp_path / "record.csv")
    assert np.allclose(found["measurement"], np.round(MEASUREMENT * factor))
    assert np.allclose(found["control"], CONTROL)


def test_a_column_that_counts_the_rows_is_no_time(tmp_path: Path) -> None:
    stamped = when("%Y-%m-%d %H:%M:%S")
    content = lines(lambda k: f"{k + 1},{stamped(k)}", "No.,DateOfSample,OP,PV,SP")
    found = read(content, tmp_path / "record.csv", "PV,OP,SP")
    assert np.allclose(np.diff(found["time"]), 60.0)
    without = lines(lambda k: f"{k + 1},{CONTROL[k]},{MEASUREMENT[k]}", "No.,OP,PV")
    with pytest.raises(InputError, match=r"first column 'No\.'; allowed: the fourth names that of time"):
        read(without, tmp_path / "record.csv", "PV,OP")


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (lines(number(lambda k: f"{k / 1440:.8f}")), "time every 0.00069444, in seconds or in days"),
        (lines(lambda k: f"{60 * k},{MEASUREMENT[k]},{CONTROL[k]},{SETPOINT[k]}")[1:], "--columns 2,3,4,1"),
        (lines(lambda k: f"{60 * k};{CONTROL[k]};{MEASUREMENT[k]:.1f}".replace(f"{MEASUREMENT[k]:.1f}", "80,5"),
               "time;control;measurement"), "allowed: decimals with a comma or with a point"),
        (lines(lambda k: f"{60 * k},,{MEASUREMENT[k]}", "time,control,measurement"), "none of which has a value of"),
        (lines(number(lambda k: 60 * k), "time [weeks],control,measurement,setpoint"), "time in weeks"),
    ],
    ids=["days or seconds", "the other order", "points and commas", "never all", "an unknown unit"],
)  # fmt: skip
def test_what_could_be_read_in_two_ways_is_refused_with_what_to_change(
    content: list[str], told: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=told):
        read(content, tmp_path / "record.csv")
