"""No text and no command line ends in a traceback, a warning, or a wait; those that once did stay here."""

from __future__ import annotations

import pytest

from fopid_core.errors import InputError
from fopid_core.model.process import Process

from .texts import Fuzzer, line_fault, text_fault

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
    ["step", "1.42/(0.484s+1)*exp(-0.403s)", "--gains", "0.691,0.437,0,1,1", "--horizon", "2.418"],
]


@pytest.mark.parametrize("line", ONCE_BROKEN, ids=lambda line: " ".join(line)[:80])
def test_a_line_that_once_ended_badly_is_answered(line: list[str]) -> None:
    assert line_fault(line) == ""


@pytest.mark.slow
def test_a_phase_that_stays_where_it_is_is_as_flat_as_the_grid_is_wide() -> None:
    assert line_fault(["tune", "frequency", "1/(s^10-1e15s)", "--u-max", "1", "--criterion", "flatness"]) == ""


@pytest.mark.slow
@pytest.mark.parametrize("method", ["frequency", "time"])
def test_a_delay_of_thirty_years_is_tuned_in_bounded_time(method: str) -> None:
    assert line_fault(["tune", method, "1/(s+1)*exp(-1e9s)", "--json"]) == ""


@pytest.mark.parametrize("text", ["e^-2s/(s+1)", "1/(s+1)*e^-2s", "1/(s+1)*e^-2*s", "e^-0.5s", "1/(s+1)*e^2s"])
def test_a_power_of_e_that_may_be_meant_as_a_delay_is_refused_with_what_to_write(text: str) -> None:
    with pytest.raises(InputError, match=r"read in two ways; write e\^\("):
        Process.parse(text)


@pytest.mark.parametrize(("text", "delay"), [("e^(-2s)/(s+1)", 2.0), ("e^-s/(s+1)", 1.0), ("(e^-2)*1/(s+1)", 0.0)])
def test_a_power_of_e_that_is_clear_is_read(text: str, delay: float) -> None:
    assert Process.parse(text).delay == delay


@pytest.mark.parametrize("seed", range(4))
def test_texts_near_the_grammar_are_read_or_refused_in_one_line(seed: int) -> None:
    fuzzer = Fuzzer(seed)
    faults = {text: fault for text in (fuzzer.process() for _ in range(100)) if (fault := text_fault(text))}
    assert not faults
