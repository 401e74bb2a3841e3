"""A result says which versions and which revision of the tree made it."""

from __future__ import annotations

import subprocess
from importlib.metadata import version
from pathlib import Path

import pytest

from fopid_core.study.bags.provenance import git_revision, provenance


def git(folder: Path, *words: str) -> str:
    identity = ["-c", "user.name=a", "-c", "user.email=a@b"]
    return subprocess.run(["git", "-C", folder, *identity, *words], capture_output=True, text=True, check=True).stdout


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A checkout that looks like this project."""
    package = tmp_path / "src" / "fopid_core" / "fopid_core"
    package.mkdir(parents=True)
    (package / "a.py").write_text("1\n")
    git(tmp_path, "init", "-q")
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-q", "-m", "first")
    return tmp_path


def test_versions_are_those_installed() -> None:
    told = provenance()["versions"]
    for package in ("fopid_core", "numpy", "scipy"):
        assert f"{package} {version(package)}" in told


def test_a_clean_checkout_is_told_by_its_revision_and_a_changed_one_by_how_much_changed(tree: Path) -> None:
    source = tree / "src" / "fopid_core" / "fopid_core" / "a.py"
    revision = git(tree, "rev-parse", "HEAD").strip()
    assert git_revision(source) == revision
    source.write_text("2\n")
    (tree / "new.txt").touch()
    assert git_revision(source) == f"{revision} (2 files changed since)"


def test_outside_a_checkout_of_this_project_there_is_no_revision(tree: Path, tmp_path: Path) -> None:
    site = tree / ".venv" / "site-packages" / "fopid_core" / "a.py"
    assert git_revision(Path("/nowhere/a.py")) == ""
    assert git_revision(site).startswith(git(tree, "rev-parse", "HEAD").strip())  # a virtual environment within it
    other = tmp_path / "other"
    other.mkdir()
    git(other, "init", "-q")
    (tree / "src").rename(tree / "elsewhere")
    assert git_revision(other / "a.py") == ""
