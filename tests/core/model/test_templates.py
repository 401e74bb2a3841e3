"""The templates are eqs. (6) to (9) of the paper."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fopid_core.errors import InputError
from fopid_core.model.templates import TEMPLATES

S = np.array([0.1 + 0.2j, 1.0 + 3.0j])
LAG = np.exp(-0.4 * S)


@pytest.mark.parametrize(
    ("name", "parameters", "value"),
    [
        ("foptd", {"K": 2.0, "T": 3.0, "L": 0.4}, 2 * LAG / (3 * S + 1)),
        ("soptd", {"K": 2.0, "a1": 3.0, "a0": 5.0, "L": 0.4}, 2 * LAG / (S**2 + 3 * S + 5)),
        ("nioptd1", {"K": 2.0, "T": 3.0, "alpha": 1.3, "L": 0.4}, 2 * LAG / (3 * S**1.3 + 1)),
        (
            "nioptd2",
            {"K": 2.0, "a1": 3.0, "a0": 5.0, "alpha": 2.1, "beta": 0.9, "L": 0.4},
            2 * LAG / (S**2.1 + 3 * S**0.9 + 5),
        ),
    ],
)
def test_a_template_is_its_equation(name: str, parameters: dict[str, float], value: np.ndarray) -> None:
    template = TEMPLATES[name]
    assert template.process(parameters)(S) == pytest.approx(value)
    assert tuple(parameters) == template.parameters


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"L": -0.1}, "delay >= 0"),
        ({"T": math.nan}, "finite"),
        ({"K": 0.0}, "numerator 0"),
        ({"alpha": 1.0}, "exactly K, T, L"),
    ],
)
def test_parameters_that_make_no_model_are_refused(change: dict[str, float], reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        TEMPLATES["foptd"].process({"K": 1.0, "T": 1.0, "L": 0.1} | change)


def test_a_missing_parameter_is_refused() -> None:
    with pytest.raises(InputError, match="parameters K of foptd"):
        TEMPLATES["foptd"].process({"K": 1.0})
