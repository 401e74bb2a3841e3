"""No transfer function ends in a traceback, a warning, or a wait; those that once did stay here."""

from __future__ import annotations

import pytest

from fopid_core.errors import InputError
from fopid_core.model.process import Process

from .texts import TextFuzzer, text_fault


@pytest.mark.parametrize("text", ["e^-2s/(s+1)", "1/(s+1)*e^-2s", "1/(s+1)*e^-2*s", "e^-0.5s", "1/(s+1)*e^2s"])
def test_a_power_of_e_that_may_be_meant_as_a_delay_is_refused_with_what_to_write(text: str) -> None:
    with pytest.raises(InputError, match=r"read in two ways; write e\^\("):
        Process.parse(text)


@pytest.mark.parametrize(("text", "delay"), [("e^(-2s)/(s+1)", 2.0), ("e^-s/(s+1)", 1.0), ("(e^-2)*1/(s+1)", 0.0)])
def test_a_power_of_e_that_is_clear_is_read(text: str, delay: float) -> None:
    assert Process.parse(text).delay == delay


@pytest.mark.parametrize("seed", range(4))
def test_texts_near_the_grammar_are_read_or_refused_in_one_line(seed: int) -> None:
    fuzzer = TextFuzzer(seed)
    faults = {text: fault for text in (fuzzer.process() for _ in range(100)) if (fault := text_fault(text))}
    assert not faults
