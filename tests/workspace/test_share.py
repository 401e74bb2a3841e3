"""Whoever runs a tenth of the long tests at each commit has run all of them after ten."""

from __future__ import annotations

import pytest

from .. import share


@pytest.mark.parametrize("count", [1, 2, 9, 10, 106])
@pytest.mark.parametrize("part", [1.0, 0.5, 0.1])
def test_turns_run_everything(count: int, part: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(share, "SHARE", part)
    turns = [share.some_of(range(count), turn) for turn in range(round(1.0 / part))]
    assert {case for turn in turns for case in turn} == set(range(count))
    assert min(len(turn) for turn in turns) == max(1, int(part * count))


def test_the_first_turn_begins_with_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(share, "SHARE", 0.1)
    assert share.some_of(range(25)) == [0, 10, 20]


@pytest.mark.parametrize("count", [1, 3, 4, 18])
def test_of_one_tests_cases_a_few_are_run_and_all_after_some_turns(count: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(share, "MOST_CASES", 3)
    run = set()
    for turn in range(6):
        monkeypatch.setattr(share, "TURN", turn)
        few = share.a_few_of(range(count))
        assert 1 <= len(few) <= 3
        run |= set(few)
    assert run == set(range(count))


def test_without_a_limit_all_cases_are_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(share, "MOST_CASES", 0)
    assert share.a_few_of(range(50)) == list(range(50))
