"""The gallery is no installed package: it is found where it stands."""

from __future__ import annotations

import os
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "examples" / "plants"))


@pytest.fixture(autouse=True)
def simulator_is_there(request: pytest.FixtureRequest) -> None:
    """Plants of other people's simulators are skipped without these; where they must be there, that is a failure."""
    from foreign_plants.gallery import SIMULATORS

    named = getattr(request.node, "callspec", None)
    module = SIMULATORS.get(named.params.get("name", "")) if named else None
    if module and find_spec(module) is None and not os.environ.get("FOPID_NEED_SIMULATORS"):
        pytest.skip(f"needs {module}: make simulators")
