"""`fopid` works with numpy, scipy, lark and click alone; what needs more says which extra brings it, in one line."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from fopid_core.cli.extras import EXTRA

RUN = """
import contextlib, importlib.abc, io, json, sys
blocked, lines = json.loads(sys.argv[1])
class Blocker(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in blocked:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Blocker())
from fopid_core.cli.main import main
found = {}
for line in lines:
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()) as told:
        try:
            main(line.split())
        except SystemExit as ended:
            found[line] = (ended.code, told.getvalue())
print(json.dumps(found))
"""
WORKS = (
    "reduce P1 --template foptd",
    "tune frequency P1 --phase-margin 80 --crossover 0.3",
    "tune rule P3 --rule fmigo",
    "evaluate P1 --gains 1,1,0,1,1",
    "step P1 --gains 1,1,0,1,1",
    "region P1 --points 10",
    "identify record.csv --template foptd",
    "export --gains 1,1,0,1,1 --out c",
)
ASKS = {
    "step P1 --gains 1,1,0,1,1 --plot a.png": "plots",
    "region P1 --points 10 --plot a.png": "plots",
    "reproduce --out paper": "plots",
    "evaluate process.yaml --gains 1,1,0,1,1": "experiments",
    "simulate process.yaml": "experiments",
    "report bag": "bags",
    "repair bag": "bags",
    "identify bag": "bags",
    "campaign process.yaml": "campaigns",
}


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[int, str]]:
    folder = tmp_path_factory.mktemp("light")
    (folder / "bag").mkdir()
    (folder / "process.yaml").write_text("process: P1\n")
    rows = [f"{0.05 * i},{float(i > 0)},{1 - 0.97**i}" for i in range(400)]
    (folder / "record.csv").write_text("time,control,measurement\n" + "\n".join(rows) + "\n")
    blocked = json.dumps([[*EXTRA, "rich", "tornado", "dask", "mpmath"], [*WORKS, *ASKS]])
    done = subprocess.run([sys.executable, "-c", RUN, blocked], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("line", WORKS)
def test_four_libraries_are_enough(found: dict[str, tuple[int, str]], line: str) -> None:
    status, told = found[line]
    assert (status in (0, 3), told) == (True, "")  # 3: done, and the record does not decide the model


@pytest.mark.parametrize("line", ASKS)
def test_what_is_missing_is_one_line_that_names_the_extra(found: dict[str, tuple[int, str]], line: str) -> None:
    status, told = found[line]
    assert status == 2
    (text,) = told.splitlines()
    assert text.startswith("fopid: this needs the Python package ")
    assert text.endswith(f"pip install 'fopid_core[{ASKS[line]}]'")


def test_every_extra_that_is_named_exists() -> None:
    setup = (Path(__file__).parents[3] / "src/fopid_core/setup.py").read_text()
    for extra in set(EXTRA.values()):
        assert f'"{extra}": [' in setup
