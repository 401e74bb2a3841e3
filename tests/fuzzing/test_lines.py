"""No command line ends in a traceback, a warning, or a wait; those that once did stay here."""

from __future__ import annotations

import pytest

from .lines import HABITS, Fuzzer, Line, line_fault, verbs

GAINS = ("--gains", "1,1,0.1,1,1")
ONCE_BROKEN = [
    ["tune", "time", "s/(s+1)"],
    ["tune", "time", "1/(s+1)*exp(-1e300s)"],
    ["evaluate", "1/(s+1)^3*e^-2s", *GAINS],
    ["evaluate", "1e-320/(s+1)", *GAINS],
    ["tune", "time", "1e-320/(s+1)"],
    ["evaluate", "1/(s+1)", *GAINS, "--horizon", "1e100"],
    ["step", "1/(s+1)", *GAINS, "--horizon", "1e308"],
    ["tune", "time", "1/(s+1)", "--horizon", "1e100"],
    ["tune", "time", "1/(s+1)", "--horizon", "1e9"],
    ["step", "1/(s+1)", *GAINS, "--points", "1000000000"],
    ["evaluate", "1/(s+1)", "--gains", "1e308,1e308,1e308,1,1"],
    ["step", "1/((s+1)^2)", "--gains", "1e308,0,0,1,1"],
    ["tune", "time", "1/(100s+1)", "--u-max", "1e-308", "--horizon", ".7", "--timeout", "3", "--json"],
    ["evaluate", "s/((0.02s+1)(10s+1)(1s+1))", "--gains", "1,1e100,1e-3,0.5,0.9", "--json"],
    ["step", "s/((3s+1)(s^2+0.1s+1))", *GAINS, "--json"],
    ["explore", "s" + 300 * "+0", "--port", "-1"],
    ["certify", "1/(s+1)", *GAINS, "--out", "/no/such/folder/proof.json"],
    ["certify", "s" + 300 * "+0", *GAINS, "--confidence", "0.9"],
    ["report", "s" + 300 * "+0"],
    ["repair", "s" + 300 * "+0"],
    ["step", "1e-3/((.7s+1)(100s+1)(1e9s+1))*exp(-10s)", "--gains", "10,1e-320,3,2,0.5", "--json"],
    ["tune", "time", "1/(s+1)", "--start", "1,9,0,2,1", "--bound", "lam=2,2", "--bound", "ki=9,9", "--timeout", "1"],
    ["evaluate", "1/(-(3s^2+0s+3))", "--gains", "2,1e3,3,1.2,1", "--json"],
    ["evaluate", "1/s", "--gains", "0,0,1e-320,0.5,0.5", "--json"],
    ["identify", "record.csv", "--control-before", "-inf", "--json"],
    ["step", "1.42/(0.484s+1)*exp(-0.403s)", "--gains", "0.691,0.437,0,1,1", "--horizon", "2.418"],
]


@pytest.mark.parametrize("line", ONCE_BROKEN, ids=lambda line: " ".join(line)[:80])
def test_a_line_that_once_ended_badly_is_answered(line: list[str]) -> None:
    assert line_fault(Line(tuple(line))) == ""


@pytest.mark.slow
def test_a_phase_that_stays_where_it_is_is_as_flat_as_the_grid_is_wide() -> None:
    assert line_fault(Line(("tune", "frequency", "1/(s^10-1e15s)", "--u-max", "1", "--criterion", "flatness"))) == ""


@pytest.mark.slow
def test_a_front_of_a_process_whose_best_design_makes_no_more_noise_than_its_integral_is_an_edge() -> None:
    line = ("front", "(1-10s)/((2s+1))*exp(-0.5s)", "--points", "20", "--sample-time", "3", "--json")
    assert line_fault(Line(line)) == ""


@pytest.mark.slow
@pytest.mark.parametrize("method", ["frequency", "time"])
def test_a_delay_of_thirty_years_is_tuned_in_bounded_time(method: str) -> None:
    assert line_fault(Line(("tune", method, "1/(s+1)*exp(-1e9s)", "--json"))) == ""


def test_every_verb_is_among_the_lines_with_options_that_it_has() -> None:
    assert set(HABITS) == set(verbs())
    for verb, habit in HABITS.items():
        assert {option for parameter in verbs()[verb].params for option in parameter.opts} >= set(habit.always), verb


def test_a_line_that_was_kept_is_read_again_as_it_was() -> None:
    fuzzer = Fuzzer(0)
    lines = [fuzzer.line() for _ in range(200)]
    assert [Line.of_bytes(line.to_bytes()) for line in lines] == lines
    assert any(line.given for line in lines)


CHEAP = ("evaluate", "step", "export", "schedule", "certify", "repair", "explore", "benchmark", "reproduce")


@pytest.mark.parametrize("seed", range(2))
def test_lines_near_good_ones_are_answered_or_refused_in_one_line(seed: int) -> None:
    fuzzer = Fuzzer(seed)
    lines = [fuzzer.line(CHEAP) for _ in range(15)]
    assert {line: fault for line in lines if (fault := line_fault(line))} == {}
