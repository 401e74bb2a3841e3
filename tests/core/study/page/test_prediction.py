"""What a page shows of gains that do not run yet."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from scipy import signal

from fopid_core.errors import ExpressionError, InputError
from fopid_core.model.process import Process
from fopid_core.study.page.prediction import answer

PID = {"kp": 2.0, "ki": 1.2, "kd": 1.5}
DELAYED = "2/(s+1)*exp(-0.5s)"


def shown(process: str, *sets: dict, **more: object) -> dict:
    return answer({"process": process, "sets": list(sets), **more})


def test_responses_are_those_of_the_rational_loop_by_scipy() -> None:
    seen = shown("1/(s+1)^3", PID, horizon=20.0)
    one, time = seen["sets"][0], np.linspace(0.0, 20.0, len(seen["time"]))
    closed = [1.0, 3.0, 3.0 + 1.5, 1.0 + 2.0, 1.2]
    setpoint = signal.step(signal.TransferFunction([1.5, 2.0, 1.2], closed), T=time)[1]
    load = signal.step(signal.TransferFunction([1.0, 0.0], closed), T=time)[1]
    assert np.abs(np.array(one["setpoint"]["output"]) - setpoint).max() < 2e-4
    assert np.abs(np.array(one["load"]["output"]) - load).max() < 2e-4
    assert np.abs(np.array(one["load"]["control"]) + setpoint).max() < 2e-4
    assert one["measures"]["overshoot_pct"]["value"] == pytest.approx(100.0 * (setpoint.max() - 1.0), abs=0.01)


def test_curves_and_margins_are_those_of_the_transfer_function() -> None:
    one = shown("1/(s+1)^3", PID)["sets"][0]
    w = np.logspace(-3.0, 3.0, 200_001)
    s = 1j * w
    opened = (2.0 + 1.2 / s + 1.5 * s) / (s + 1.0) ** 3
    assert one["margins"]["ms"]["value"] == pytest.approx(np.abs(1.0 / (1.0 + opened)).max(), rel=1e-6)
    crossover = w[np.argmin(np.abs(np.log(np.abs(opened))))]
    assert one["margins"]["crossover"]["value"] == pytest.approx(crossover, rel=1e-4)
    curve = np.array(one["nyquist"]["re"]) + 1j * np.array(one["nyquist"]["im"])
    assert np.abs(np.abs(curve) - 10.0 ** (np.array(one["bode"]["gain_db"]) / 20.0)).max() < 1e-3 * np.abs(curve).max()


def test_the_phase_of_a_delay_falls_without_jumps() -> None:
    seen = shown(DELAYED, {"kp": 0.5})
    phase, w = np.array(seen["sets"][0]["bode"]["phase_deg"]), np.array(seen["frequency"])
    assert np.abs(phase - np.degrees(-0.5 * w - np.arctan(w))).max() < 1e-2 * np.abs(phase).max()


@pytest.mark.parametrize(
    ("process", "gains", "badge"),
    [
        ("1/(s+1)^3", {"kp": 7.9}, "stable"), ("1/(s+1)^3", {"kp": 8.1}, "unstable"),
        ("1/(s-1)", {"kp": 2.0}, "stable"), ("1/(s-1)", {"kp": 0.5}, "unstable"),
        ("1/(s+1)^3", {"kp": 8.0}, "undecided"), ("1/s*exp(-s)", {"kp": 1.5}, "stable"),
        ("1/s*exp(-s)", {"kp": 1.6}, "unstable"),
    ],
)  # fmt: skip
def test_the_badge_is_the_exact_verdict(process: str, gains: dict, badge: str) -> None:
    """The borders are 8 (Routh), 1 and pi / 2."""
    one = shown(process, gains)["sets"][0]
    assert one["verdict"]["badge"] == badge
    if badge != "stable":
        assert all(part["value"] is None and part["reason"] for part in one["margins"].values())
        assert one["measures"]["overshoot_pct"]["value"] is None


@pytest.mark.parametrize("gains", [{"kp": 0.5, "ki": 0.3}, {"kp": 0.4, "ki": 0.3, "kd": 0.05, "lam": 0.9, "mu": 0.6}])
@pytest.mark.parametrize("more", [{}, {"filter_order": 2, "filter_time": 0.3, "setpoint_weight": 0.5}])
def test_while_the_hand_moves_responses_are_drawn_nearly_right(gains: dict, more: dict) -> None:
    quick, exact = (shown(DELAYED, gains | more, horizon=15.0, quick=q)["sets"][0] for q in (True, False))
    assert (quick["exact"], exact["exact"]) == (False, True)
    for source in ("setpoint", "load"):
        for name in ("output", "control"):
            near, right = (np.array(one[source][name][20:], dtype=float) for one in (quick, exact))
            assert np.nanmax(np.abs(near - right)) < 0.02 * max(1.0, np.nanmax(np.abs(right))), (source, name)
    assert quick["margins"] == exact["margins"]


def test_what_is_not_known_is_null_and_says_why() -> None:
    one = shown("1/(s+1)", {"kp": 0.5})["sets"][0]
    assert one["margins"]["phase_margin_deg"] == {"value": None, "reason": "infinite: the loop gain never crosses 1"}
    json.dumps(one, allow_nan=False)


def test_no_controller_at_all_can_be_shown() -> None:
    one = shown("1/(s+1)^3", {})["sets"][0]
    assert one["verdict"]["badge"] == "stable"
    assert max(map(abs, one["setpoint"]["output"])) < 1e-12


def test_a_process_can_be_given_by_who_asks() -> None:
    assert answer({"sets": [PID]}, Process.parse("3/(2s+1)"))["process"] == str(Process.parse("3/(2s+1)"))


@pytest.mark.parametrize(
    ("request_", "named"),
    [
        ({"process": "1/(s+1)", "sets": []}, "sets"), ({"process": "1/(s+1)", "sets": [1]}, "set of gains"),
        ({"process": "1/(s+1)", "sets": [{"kp": math.inf}]}, "kp"), ({"process": "P1", "sets": [{"kp": "1"}]}, "kp"),
        ({"process": "1/(s+1)", "sets": [{"lam": 3}]}, "lam"), ({"process": "1/(s+1)", "sets": [{"x": 3}]}, "'x'"),
        ({"process": "1/(s+1)", "sets": [{"filter_order": 7}]}, "filter_order"), ({"sets": [{}]}, "process"),
        ({"process": "1/(s+1)", "sets": [{}], "horizon": -1}, "horizon"), ({"file": "/etc/passwd"}, "'file'"),
        ({"process": "/etc/hostname", "sets": [{}]}, "character 1"), ({"process": "1+" * 5000, "sets": [{}]}, "2000"),
        ({"process": "1/(s+1)", "sets": [{"kp": True}]}, "kp"), ({"process": "1/(s+1)", "sets": [{}] * 9}, "1 to 8"),
    ],
)  # fmt: skip
def test_bad_requests_are_named(request_: dict, named: str) -> None:
    with pytest.raises(InputError, match=named):
        answer(request_)


def test_an_error_in_the_process_has_its_place() -> None:
    with pytest.raises(ExpressionError) as told:
        shown("1/(s+1)^3)", PID)
    assert told.value.position == 9
