"""The repetitions count what went wrong, and nothing where nothing did."""

from __future__ import annotations

from dataclasses import replace

import pytest
import repetitions
from foreign_plants.gallery import GALLERY

from fopid_ros.tuner.learning import closed_loop_experiment
from fopid_ros.tuner.learning.closed_loop_experiment import ExperimentSettings


def test_an_experiment_that_stays_in_its_bounds_is_counted_as_one_that_came_to_its_end() -> None:
    assert repetitions.line("flexible_joint", [3]) == "| flexible_joint | 1 | 1 | 0 | 0 |"


def test_one_that_leaves_what_is_safe_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    narrow = replace(GALLERY["flexible_joint"], unsafe=(1.99, 2.01))
    monkeypatch.setitem(GALLERY, "flexible_joint", narrow)
    assert repetitions.experiment("flexible_joint", 3) == (True, False, True)


@pytest.fixture
def short_probes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the heat exchanger, whose answer comes late: moves that are too large follow from those."""
    monkeypatch.setattr(closed_loop_experiment, "PROBE_SHARE_MOST", closed_loop_experiment.PROBE_SHARE_UNTIL_KNOWN)


@pytest.mark.usefixtures("short_probes")
def test_one_that_barely_leaves_a_band_nobody_asked_for_is_made_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    assert repetitions.experiment("heat_exchanger", 6) == (True, False, False)
    monkeypatch.setattr(closed_loop_experiment, "AGAIN", 0)
    assert repetitions.experiment("heat_exchanger", 6) == (False, False, False)


@pytest.mark.usefixtures("short_probes")
def test_a_band_that_was_asked_for_ends_it(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = ExperimentSettings(deviation_max=1.8)
    monkeypatch.setattr(repetitions, "ExperimentSettings", lambda: asked)
    assert repetitions.experiment("heat_exchanger", 6) == (False, False, False)
