"""The front page is two screens, its links lead somewhere, and its lines run."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from fopid_core.errors import InputError
from fopid_core.model.process import read_process

from .markdown import run

ROOT = Path(__file__).parents[2]
README = ROOT / "README.md"
MADE_BY_THE_BUILD = "generated/"


def pages() -> list[Path]:
    written = (page for page in (ROOT / "docs").rglob("*.md") if "generated" not in page.parts)
    return sorted([README, ROOT / "CONTRIBUTING.md", *written, *(ROOT / "examples").glob("*/README.md")])


def test_two_screens() -> None:
    assert len(README.read_text().splitlines()) <= 100


@pytest.mark.parametrize("page", pages(), ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    targets = re.findall(r"\]\(([^)#\s]+)[^)]*\)", page.read_text())
    local = [target for target in targets if "://" not in target and MADE_BY_THE_BUILD not in target]
    assert [target for target in local if not (page.parent / target).exists()] == []


def test_what_it_says_of_processes_is_so() -> None:
    text = README.read_text()
    for process in ("1/(0.8s^2.2+0.5s^0.9+1)", "3.13/(433.33s+1)*exp(-50s)", "2/((s+1)(0.3s+1)) * exp(-0.2s)"):
        assert process in text
        read_process(process)
    assert "`1/(s+1)(s+2)`" in text
    with pytest.raises(InputError, match="character"):
        read_process("1/(s+1)(s+2)")


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_its_lines_run(tmp_path: Path) -> None:
    run(README, tmp_path)
    assert (tmp_path / "compared.png").stat().st_size > 10_000


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_the_lines_of_the_command_line_page_run(tmp_path: Path) -> None:
    run(ROOT / "docs" / "howto" / "command_line.md", tmp_path)
    assert (tmp_path / "proof.json").exists()
