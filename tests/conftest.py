"""What holds for all tests."""

from __future__ import annotations

import gc
import os
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from .share import SHARE, TURN, a_few_of, some_of

if TYPE_CHECKING:
    from .chromium import Browser

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as `make` sets it: ten times faster on a busy machine

CAMPAIGNS = Path(__file__).parent / "reliability"  # take their share of the work themselves
OVER_ROS = {CAMPAIGNS, *(Path(__file__).parent / folder for folder in ("ros", "docs", "examples"))}


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark what starts ROS nodes; of each test's cases, and of the long tests, keep as many as the share asks for.

    The long tests take turns, and so do slow ones of one case, in two halves: who runs a share of them again and again
    has run all some day.
    """
    groups: dict[tuple[str, bool], list[pytest.Item]] = defaultdict(list)
    long = []
    for item in items:
        if OVER_ROS.intersection(item.path.parents):
            item.add_marker(pytest.mark.ros)
        if item.get_closest_marker("long"):
            item.add_marker(pytest.mark.slow)
            long.append(item)
        elif CAMPAIGNS not in item.path.parents:
            is_slow = item.get_closest_marker("slow") is not None
            groups[item.nodeid.partition("[")[0], is_slow].append(item)
    if config.getoption("lf", default=False):  # what has failed was among those
        return
    alone: list[pytest.Item] = []
    kept = set(some_of(long, TURN))
    for (_, is_slow), group in groups.items():
        if is_slow and len(group) == 1:
            alone += group
        else:
            kept.update(a_few_of(some_of(group)))
    kept.update(some_of(alone, TURN, 1 if SHARE > 0.5 else 2))
    left_out = {*long, *(item for group in groups.values() for item in group)} - kept
    if left_out:
        config.hook.pytest_deselected(items=[item for item in items if item in left_out])
        items[:] = [item for item in items if item not in left_out]


def pytest_collection_finish() -> None:
    """What collecting has brought stays to the end: no search for garbage need go through it again and again."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """A browser for all tests of a file, which are marked ``NEEDS_BROWSER``."""
    from .chromium import Browser  # wants tornado

    browser = Browser(tmp_path_factory.mktemp("browser") / "profile")
    yield browser
    browser.close()
