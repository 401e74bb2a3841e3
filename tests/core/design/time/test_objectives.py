"""Costs are the integrals and measures that their names say."""

from __future__ import annotations

import math

import control
import numpy as np
import pytest

from fopid_core.design.time.objectives import (
    OBJECTIVES,
    ZAMANI_PARTS,
    LoopResponses,
    Objective,
    gain_margin,
    phase_margin,
)
from fopid_core.errors import InputError

TIME = np.linspace(0.0, 40.0, 40001)
W = np.geomspace(1e-3, 1e3, 2000)
# of the error exp(-t): integrals of |e|, t|e|, e^2, t e^2, (t^2 e)^2, t^2 e^2
CLOSED_FORM = {"iae": 1.0, "itae": 1.0, "ise": 0.5, "itse": 0.25, "istes": 0.75, "istse": 0.25}


def cost(objective: Objective, errors: np.ndarray, controls: np.ndarray | None = None, loop: complex = 0j) -> float:
    loops = np.full((1, len(W)), loop) if np.isscalar(loop) else loop
    responses = LoopResponses(TIME, errors[None], controls, W, loops)
    return float(objective.cost(responses, objective.time_weights(TIME))[0])


@pytest.mark.parametrize(("name", "expected"), CLOSED_FORM.items())
def test_indices_of_an_exponential_error_are_known_in_closed_form(name: str, expected: float) -> None:
    assert cost(Objective.of(name, {}), np.exp(-TIME)) == pytest.approx(expected, rel=1e-5)
    assert cost(Objective.of(name, {}), -np.exp(-TIME)) == pytest.approx(expected, rel=1e-5)


def test_the_sum_weighs_all_six_equally_unless_weights_are_given() -> None:
    assert cost(Objective.of("sum", {}), np.exp(-TIME)) == pytest.approx(sum(CLOSED_FORM.values()), rel=1e-5)
    weighted = Objective.of("sum", {"iae": 2.0, "istes": 4.0})
    assert cost(weighted, np.exp(-TIME)) == pytest.approx(2.0 * 1.0 + 4.0 * 0.75, rel=1e-5)


def test_control_energy_is_added_to_an_index() -> None:
    objective = Objective.of("energy", {"iae": 1.0, "energy": 3.0})
    assert objective.needs_control
    found = cost(objective, np.exp(-TIME), controls=2.0 * np.exp(-TIME)[None])
    assert found == pytest.approx(1.0 + 3.0 * 2.0, rel=1e-2)


@pytest.mark.parametrize(
    ("part", "expected"),
    [
        ("overshoot", math.exp(-math.pi * 0.5 / math.sqrt(0.75))),
        ("steady_state_error", 0.0),
    ],
)
def test_parts_of_zamanis_composite_for_a_second_order_response(part: str, expected: float) -> None:
    """Damping 0.5, natural frequency 1: the textbook overshoot."""
    wd = math.sqrt(0.75)
    errors = np.exp(-0.5 * TIME) * (np.cos(wd * TIME) + 0.5 / wd * np.sin(wd * TIME))
    objective = Objective.of("zamani", {part: 1.0})
    assert not objective.is_integral
    assert cost(objective, errors, loop=np.full((1, len(W)), 0.5 + 0j)) == pytest.approx(expected, abs=1e-4)


def test_rise_and_settling_time_of_a_first_order_response() -> None:
    errors = np.exp(-TIME)
    flat = np.full((1, len(W)), 0.5 + 0j)
    assert cost(Objective.of("zamani", {"rise_time": 1.0}), errors, loop=flat) == pytest.approx(math.log(9.0), abs=1e-3)
    assert cost(Objective.of("zamani", {"settling_time": 1.0}), errors, loop=flat) == pytest.approx(
        math.log(50.0), abs=2e-3
    )


@pytest.mark.parametrize("gain", [2.0, 4.0, 7.0])
def test_margins_on_a_grid_are_those_of_python_control(gain: float) -> None:
    plant = control.tf([gain], [1.0, 3.0, 3.0, 1.0])
    gm, pm, _, _ = control.margin(plant)
    loop = (gain / (1j * W + 1.0) ** 3)[None]
    assert float(gain_margin(loop)[0]) == pytest.approx(gm, rel=1e-3)
    assert float(phase_margin(loop)[0]) == pytest.approx(math.radians(pm), rel=1e-3)
    inverse = cost(Objective.of("zamani", {"gain_margin": 1.0}), np.exp(-TIME), loop=loop)
    assert inverse == pytest.approx(1.0 / gm, rel=1e-3)


def test_zamanis_composite_is_the_sum_of_its_parts() -> None:
    loop = (2.0 / (1j * W + 1.0) ** 3)[None]
    controls = np.exp(-TIME)[None]
    parts = sum(
        cost(Objective.of("zamani", {part: 1.0}), np.exp(-TIME), controls if part == "energy" else None, loop)
        for part in ZAMANI_PARTS
    )
    assert cost(Objective.of("zamani", {}), np.exp(-TIME), controls, loop) == pytest.approx(parts, rel=1e-9)


@pytest.mark.parametrize(
    ("name", "weights", "what"),
    [
        ("best", {}, "index = 'best'"),
        ("sum", {"energy": 1.0}, "weights = 'energy'"),
        ("itae", {"iae": 1.0}, "weights = 'iae'"),
        ("sum", {"iae": -1.0}, "weight of iae = -1"),
        ("sum", {"iae": math.nan}, "weight of iae = nan"),
        ("sum", {"iae": 0.0}, "at least one above 0"),
    ],
)
def test_weights_that_mean_nothing_are_refused(name: str, weights: dict[str, float], what: str) -> None:
    with pytest.raises(InputError, match=what):
        Objective.of(name, weights)


def test_every_objective_can_be_made_by_name() -> None:
    assert {Objective.of(name, {}).name for name in OBJECTIVES} == set(OBJECTIVES)
