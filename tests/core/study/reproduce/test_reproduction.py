"""``fopid reproduce``: everything is computed and written, with progress on stderr only."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest
from PIL import Image

from fopid_core.study.reproduce import reproduction
from fopid_core.study.reproduce.claims import Claim
from fopid_core.study.reproduce.page import Reproduction

from ...cli.runner import invoke
from .parts import small_reproduction


@pytest.fixture(scope="module")
def found() -> Reproduction:
    return small_reproduction()


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch, found: Reproduction) -> Reproduction:
    claim = Claim("A claim.", "Section 1", {"P1": True, "P2": False}, {}, "1 against 2")
    monkeypatch.setattr(reproduction, "_compute", lambda _: (found, (claim,)))
    return found


@pytest.mark.slow
def test_all_is_written_and_the_json_holds_it_too(small: Reproduction, tmp_path: Path) -> None:
    out = tmp_path / "new" / "folder"
    done = invoke(["reproduce", "--out", str(out), "--json"])
    assert done.exit_code == 0, done.output
    data = json.loads(done.stdout)
    assert set(data) == {"out", "files", "claims", "tables", "errata"}
    assert set(map(Path, data["files"])) == {path for path in out.rglob("*") if path.is_file()}
    assert data["claims"][0]["verdict"] == "not for P2"
    assert [erratum["key"] for erratum in data["errata"]] == [erratum.key for erratum in small.errata]
    assert all(erratum["confirmed"] for erratum in data["errata"])
    with (out / "tables" / "table4.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["tuned for"] for row in rows] == ["ITAE", "SUM"]
    assert float(rows[0]["index printed"]) == 5.2762 == data["tables"]["table4"][0]["index printed"]
    with Image.open(out / "figures" / "figure01.png") as picture:
        assert picture.size == (1380, 1800)


@pytest.mark.slow
def test_people_get_a_table_of_what_was_written(
    small: Reproduction, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reproduction, "write_files", lambda figure, folder: [folder / f"{figure.name}.png"])
    done = invoke(["reproduce", "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    for words in ("index.html", "errata.md", "tables/table3.csv", "figures/figure06.png"):
        assert words in done.stdout


def test_a_place_that_cannot_be_written_is_said_before_anything_is_computed(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    done = invoke(["reproduce", "--out", str(tmp_path / "file" / "sub")])
    assert done.exit_code == 2
    (line,) = done.stderr.splitlines()
    assert "cannot be written" in line
    assert str(tmp_path / "file" / "sub") in line


@pytest.mark.long
@pytest.mark.timeout(900)
def test_the_whole_paper(tmp_path: Path) -> None:
    seen: list[tuple[float, str]] = []
    written = reproduction.reproduce(tmp_path, lambda share, what: seen.append((share, what)))
    found = written.found
    shares = [share for share, _ in seen]
    assert shares == sorted(shares)
    assert shares[0] == 0.0
    assert 0.97 < shares[-1] < 1.0  # the last step is being done
    assert {t.key for t in found.tables} >= {"table1_2", "table3", *(f"table{n}" for n in range(4, 8))}
    assert [len(t.rows) for t in found.tables] == [16, 8, 12, *[7] * 8]
    assert [figure.number for figure in found.figures] == list(range(1, 11))
    assert len(list((tmp_path / "figures").glob("*.png"))) == len(list((tmp_path / "figures").glob("*.svg"))) == 10
    assert (tmp_path / "index.html").stat().st_size < 10_000_000
    rows = found.time_rows
    assert [(row.printed.process, row.printed.index) for row in rows if not row.index_reproduced] == [("P4", "SUM")]
    assert all(row.beaten for row in rows), [row.printed for row in rows if not row.beaten]
    assert all(row.practical.success for row in rows)
    best = {(r["process"], r["template"]): r["H2 error of our optimum"] for r in found.tables[0].records()}
    assert all(best[p, "NIOPTD-II"] == min(e for (q, _), e in best.items() if q == p) for p in ("P1", "P2", "P3", "P4"))
