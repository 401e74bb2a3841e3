"""What ~/autotune is asked, from a goal and the node's parameters."""

from __future__ import annotations

import pytest

from fopid_msgs.action import Autotune
from fopid_ros.tuner import messages, parameters


@pytest.mark.parametrize("until_known", [False, True])
def test_the_parameter_says_whether_an_experiment_ends_once_enough_is_known(until_known: bool) -> None:
    defaults = {spec.name: spec.default for spec in parameters.SPECS}
    assert defaults["autotune.until_known"] is True
    asked = messages.autotune_request(Autotune.Goal(), {**defaults, "autotune.until_known": until_known})
    assert asked.experiment.until_known is until_known


@pytest.mark.parametrize("second", [False, True])
def test_the_parameter_says_whether_a_second_round_may_follow(second: bool) -> None:
    defaults = {spec.name: spec.default for spec in parameters.SPECS}
    assert defaults["autotune.second_round"] is True
    asked = messages.autotune_request(Autotune.Goal(), {**defaults, "autotune.second_round": second})
    assert asked.second_round is second
