"""How long tests wait: PATIENCE in the environment stretches their limits, for a run that slows everything.

A plugin: ``make coverage`` asks for fourfold patience, since counting branches slows programs two- to threefold.
"""

from __future__ import annotations

import os

import pytest

FACTOR = float(os.environ.get("PATIENCE", "1"))


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Stretch the time after which a test is ended."""
    for item in items:
        own = item.get_closest_marker("timeout")
        seconds = own.args[0] if own else float(config.getini("timeout"))
        item.add_marker(pytest.mark.timeout(FACTOR * seconds), append=False)
