"""axe-core, run in a page: what a screen reader or a weak eye would stumble over.

It is no part of the packages: npm brings it into ``build/axe`` when a test first asks for it.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import tarfile
import tempfile
from pathlib import Path

import pytest

from .chromium import Page

VERSION = "4.10.3"
FOLDER = Path(__file__).parents[1] / "build" / "axe"
WORTH_A_WORD = ("serious", "critical")


def script() -> str:
    """The text of axe-core; the test is skipped, with the reason, where it cannot be had."""
    archive = FOLDER / f"axe-core-{VERSION}.tgz"
    if not archive.exists():
        npm = shutil.which("npm")
        if npm is None:
            pytest.skip("axe-core is not there, and no npm to bring it")
        FOLDER.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=FOLDER) as own:  # another worker may bring it at the same time
            command = [npm, "pack", f"axe-core@{VERSION}", "--pack-destination", own]
            done = subprocess.run(command, cwd=own, capture_output=True, text=True, timeout=100)
            if done.returncode:
                pytest.skip(f"axe-core cannot be had: {done.stderr.strip().splitlines()[-1:]}")
            Path(own, archive.name).replace(archive)
    with tarfile.open(archive) as content:
        member = content.extractfile("package/axe.min.js")
        assert member is not None
        return member.read().decode()


def problems(page: Page) -> list[str]:
    """What axe-core calls serious or critical in a page."""
    page.run(script() + "; 0")
    found = page.run("axe.run(document).then(({ violations }) => violations)")
    return [
        f"{one['id']}: {one['help']}: {json.dumps([node['html'][:120] for node in one['nodes']])}"
        for one in found
        if one["impact"] in WORTH_A_WORD
    ]
