"""Loops with delay from one delay to the next: not refused for many delays, stiff lags or twin poles."""

from __future__ import annotations

import os

import numpy as np
import pytest

from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.method_of_steps import Steps
from fopid_core.model.process import Process
from fopid_core.model.response import step_response
from fopid_core.model.step_transforms import StepTransforms
from fopid_core.model.two_degrees import MeasurementFilter, SetpointWeights

from ...share import share_of
from .exponentials import by_exponentials
from .extreme_loops import ExtremeGenerator
from .random_loops import RandomLoop

LOOPS = int(os.environ.get("FOPID_LOOPS") or share_of(100))
KINDS = ("long_neutral", "stiff_delayed", "delayed_twin", "unstable_delayed", "delayed_resonant", "delayed", "neutral")


def missed(case: RandomLoop, random: np.random.Generator) -> tuple[list[str], int]:
    """Signals that are off by more than they say, and how many could be told."""
    wrong, told = [], 0
    for source in ("setpoint", "load"):
        response = step_response(case.loop, case.horizon, source, points=int(random.integers(50, 3000)))
        for signal, values, sizes, claimed in (
            ("error", response.error, response.output, response.accuracy),
            ("control", response.control, response.control, response.control_accuracy),
        ):
            exact = by_exponentials(case, source, signal)
            if exact is None:
                continue
            told += 1
            for i in {*random.integers(1, values.size, 3).tolist(), values.size - 1}:
                turns = float(response.time[i]) / float(case.delay)
                if abs(turns - round(turns)) < 1e-9:
                    continue
                off = abs(float(values[i]) - exact(float(response.time[i])))
                if off > claimed * max(1.0, float(np.abs(sizes[: i + 1]).max())):
                    wrong.append(f"{case}, {source}, {signal} at {response.time[i]!r}: off by {off:.3g}")
    return wrong, told


def misses(seed: int, count: int) -> tuple[list[str], int]:
    generator, random = ExtremeGenerator(seed), np.random.default_rng(seed)
    results = [missed(getattr(generator, KINDS[i % len(KINDS)])(), random) for i in range(count)]
    return [text for wrong, _ in results for text in wrong], sum(told for _, told in results)


def test_a_few_loops_of_each_kind_are_as_exact_as_they_say() -> None:
    wrong, told = misses(1, len(KINDS))
    assert wrong == []
    assert told >= len(KINDS)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_loops_with_delay_at_the_extremes_are_as_exact_as_they_say() -> None:
    wrong, told = misses(20261123, LOOPS)
    assert wrong == []
    assert told > LOOPS


@pytest.mark.parametrize(
    ("text", "gains", "horizon"),
    [
        ("1/(s+1)*exp(-s)", (0.2, 0.1, 0.99), 300.0),  # an echo that hardly dies out
        ("1/((1e-6s+1)(s+1))*exp(-s)", (0.4, 0.2), 30.0),  # much faster than the delay
        ("1/(s^2+1e-4s+1)^2*exp(-s)", (1e-6,), 500.0),  # the same lightly damped poles twice
    ],
)
def test_what_could_not_be_answered_by_inversion_is(text: str, gains: tuple[float, ...], horizon: float) -> None:
    response = step_response(Loop(Process.parse(text), Fopid(*gains)), horizon)
    assert response.accuracy < 1e-7


@pytest.mark.parametrize("source", ["setpoint", "load"])
def test_filter_and_setpoint_weights_are_solved_as_they_are_inverted(source: str) -> None:
    from fopid_core.model.delayed import Delayed

    loop = Loop(
        Process.parse("2*(0.5s+1)/((3s+1)(s+1))*exp(-0.7s)"),
        Fopid(0.8, 0.3, 0.4),
        MeasurementFilter(2, 0.1),
        SetpointWeights(0.6, 0.0),
    )
    transforms = StepTransforms.of(loop, source)  # type: ignore[arg-type]
    steps, inverted = Steps.of(transforms, 20.0), Delayed.of(transforms, 20.0)
    assert steps is not None
    time = np.linspace(0.0, 20.0, 777)[1:]
    assert np.all(np.abs(steps.at(time) - inverted.at(time)) <= steps.error_at(time) + inverted.error_at(time))


def test_samples_on_both_sides_of_a_jump_keep_an_index_sharp() -> None:
    """``1/(s+1) exp(-s)`` under ``0.5 (1 + s)``: the error is 1, 0.5, 0.75, ... from one delay to the next."""
    from fopid_core.model.response_indices import response_indices

    response = step_response(Loop(Process.parse("1/(s+1)*exp(-s)"), Fopid(0.5, 0.0, 0.5)), 10.0)
    found, claimed = response_indices(response.time, response.error, response.uncertainty)
    errors = 2.0 / 3.0 + (-0.5) ** np.arange(10) / 3.0
    assert abs(found.iae - errors.sum()) <= claimed.iae < 1e-9
    assert abs(found.ise - (errors**2).sum()) <= claimed.ise < 1e-9


def test_only_whole_orders_and_one_delay_are_solved_so() -> None:
    for text, gains in (("1/(s^0.5+1)*exp(-s)", (1.0,)), ("1/(s+1)*exp(-s)", (1.0, 0.5, 0.0, 0.9))):
        assert Steps.of(StepTransforms.of(Loop(Process.parse(text), Fopid(*gains)), "setpoint"), 10.0) is None
