"""The reliability suite: ``make reliability``; each test leaves its figures for docs/reliability.md."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from ..ros.conftest import Graph
from ..ros.conftest import graph as graph  # the fixture
from ..share import SHARE
from .rig import Rig

HERE = Path(__file__).parent
FIGURES = Path(os.environ.get("FOPID_FIGURES", HERE.parents[1] / "build/reliability"))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """All that starts nodes here is a campaign of minutes."""
    for item in items:
        if HERE in item.path.parents and not any(name in item.path.name for name in ("record", "cable")):
            item.add_marker(pytest.mark.reliability)
            item.add_marker(pytest.mark.timeout(3600))


@pytest.fixture
def rig(graph: Graph, tmp_path: Path) -> Iterator[Rig]:
    """A loop of the four nodes at its setpoint."""
    made = Rig(graph, tmp_path)
    try:
        made.begin()
        yield made
    finally:
        made.close()


@pytest.fixture
def figures(request: pytest.FixtureRequest) -> Callable[..., None]:
    """Write a part's figures to where the page is made from."""

    def write(part: str, **values: Any) -> None:
        FIGURES.mkdir(parents=True, exist_ok=True)
        written = {"share": SHARE, "load_average": os.getloadavg()[0], **values}
        (FIGURES / f"{part}.json").write_text(json.dumps(written, indent=1))

    return write
