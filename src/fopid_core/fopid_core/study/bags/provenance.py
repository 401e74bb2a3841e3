"""What a result was made with: versions, and the revision of the project's tree when it is run from a checkout."""

from __future__ import annotations

import platform
import shutil
import subprocess
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

PACKAGES = (
    "fopid_core", "fopid_ros", "fopid_msgs", "numpy", "scipy", "control", "rosbags", "mcap", "ros-jazzy-rclpy",
)  # fmt: skip
"""Those that take part in a run; what is not installed is left out."""

_TREE = Path("src", "fopid_core", "fopid_core")


def provenance(source: Path = Path(__file__)) -> dict[str, str]:
    """Texts for a bag's metadata or a report.

    Parameters
    ----------
    source : Path
        A file of the project's tree.

    Returns
    -------
    dict
        ``versions``; ``git``, such as ``1f8d955c... (3 files changed since)``, when ``source`` is in a checkout.

    Examples
    --------
    >>> provenance(Path("/nowhere"))["versions"].startswith("Python 3")
    True
    """
    found = {"versions": ", ".join([f"Python {platform.python_version()}", *_versions(PACKAGES)])}
    revision = git_revision(source)
    return {**found, "git": revision} if revision else found


def _versions(packages: Sequence[str]) -> list[str]:
    found = []
    for package in packages:
        try:
            found.append(f"{package} {version(package)}")
        except PackageNotFoundError:
            continue
    return found


def git_revision(source: Path) -> str:
    """The revision of the checkout of this project that a file is in, and how many files differ from it; or empty."""
    root = next((parent for parent in source.parents if (parent / _TREE).is_dir()), None)
    if root is None or not (root / ".git").exists() or shutil.which("git") is None:
        return ""
    revision = _git(root, "rev-parse", "HEAD").strip()
    changed = len(_git(root, "status", "--porcelain").splitlines())
    return f"{revision} ({changed} files changed since)" if revision and changed else revision


def _git(root: Path, *words: str) -> str:
    """What git answers; nothing when it refuses."""
    command = ["git", "-C", str(root), "--no-optional-locks", *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=10.0, check=False).stdout
