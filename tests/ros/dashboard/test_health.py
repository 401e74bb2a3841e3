"""What the page says of the loop: the worst that is known, and nothing that is not known."""

from __future__ import annotations

import math
from types import SimpleNamespace as Thing
from typing import Any

import pytest

from fopid_ros.dashboard.health import FORGOTTEN, HUGE, OUTDATED, RECENT, SILENCE, Health

CONTROLLER, TUNER = "/fopid_controller", "/fopid_tuner"


class Told:
    """A health whose time stands still but for ``wait``."""

    def __init__(self) -> None:
        self.time = 100.0
        self.health = Health(CONTROLLER, TUNER, lambda: self.time)

    def wait(self, seconds: float) -> None:
        self.time += seconds

    def tick(self, **more: Any) -> None:
        usual = {"setpoint": 1.0, "measurement": 0.9, "control": 0.5, "saturated": False, "stale": False, "refused": 0,
                 "mode": 0, "sample_interval": 0.01, "overruns": 0, "measurement_age": 0.004}  # fmt: skip
        self.health.take_state(Thing(**{**usual, **more}))

    def report(self, name: str, level: int = 0, text: str = "auto", hardware: str = "fopid", **facts: str) -> None:
        values = [Thing(key=key, value=value) for key, value in facts.items()]
        status = Thing(name=name, level=bytes([level]), message=text, values=values, hardware_id=hardware)
        self.health.take_diagnostics([status])

    @property
    def facts(self) -> dict[str, Any]:
        return self.health.facts()


def test_without_a_word_from_anybody_nothing_is_known() -> None:
    facts = Told().facts
    assert facts["level"] == "unknown"
    assert facts["problems"] == []
    known = {name: value for name, value in facts.items() if name not in ("level", "problems", "values", "ages")}
    assert set(known.values()) == {None}
    assert set(facts["values"].values()) == set(facts["ages"].values()) == {None}


def test_a_loop_that_ticks_is_well() -> None:
    told = Told()
    told.tick()
    told.report(CONTROLLER, **{"age of the setpoint [s]": "2.5"})
    told.wait(0.5)
    facts = told.facts
    assert facts["level"] == "ok"
    assert facts["values"] == {"setpoint": 1.0, "measurement": 0.9, "control": 0.5}
    assert facts["ages"] == {"measurement": pytest.approx(0.504, abs=0.01), "setpoint": 3.0}


def test_a_stale_measurement_is_an_error_at_once_and_no_present_value() -> None:
    told = Told()
    told.tick()
    told.wait(0.11)
    told.tick(stale=True, measurement_age=1.2)
    facts = told.facts
    assert facts["level"] == "error"
    assert "measurement stale, 1.2 s old" in facts["problems"][0]["text"]
    assert facts["values"]["measurement"] is None
    assert facts["values"]["setpoint"] == 1.0


def test_a_controller_that_falls_silent_is_an_error_within_its_patience() -> None:
    told = Told()
    told.tick()
    told.wait(SILENCE + 0.01)
    facts = told.facts
    assert facts["level"] == "error"
    assert facts["problems"][0]["text"].startswith("no tick for")
    assert {facts[name] for name in ("saturated", "stale", "mode", "interval", "overruns", "refused")} == {None}
    assert set(facts["values"].values()) == {None}


def test_a_slow_controller_is_given_the_time_of_its_ticks() -> None:
    told = Told()
    for _ in range(3):
        told.tick(sample_interval=2.0, measurement_age=0.1)
        told.wait(2.0)
    assert told.facts["level"] == "ok"
    told.wait(4.5)
    assert told.facts["level"] == "error"


@pytest.mark.parametrize("signal", ["setpoint", "measurement", "control"])
def test_what_is_huge_is_called_diverged(signal: str) -> None:
    told = Told()
    told.tick(**{signal: -6.9e95})
    facts = told.facts
    assert facts["values"][signal] == -6.9e95
    assert facts["problems"][0] == {"level": "error", "who": signal, "text": "-6.9e+95: diverged"}
    told.tick(**{signal: 0.99 * HUGE})
    assert told.facts["level"] == "ok"


def test_numbers_that_are_none_are_not_known() -> None:
    told = Told()
    told.tick(setpoint=math.nan, control=math.inf, measurement_age=math.inf, sample_interval=0.0)
    facts = told.facts
    assert facts["values"]["setpoint"] is None
    assert facts["values"]["control"] is None
    assert facts["ages"]["measurement"] is None
    assert facts["interval"] is None


def test_refused_values_are_told_for_a_while() -> None:
    told = Told()
    told.tick(refused=3)
    assert told.facts["problems"] == []  # before the page listened
    told.tick(refused=5)
    assert told.facts["problems"][0]["text"] == f"2 values refused in the last {RECENT:.0f} s"
    for _ in range(12):
        told.wait(1.0)
        told.tick(refused=5)
    assert told.facts["level"] == "ok"
    assert told.facts["refused"] == 5


def test_a_control_at_its_limit_for_long_is_a_warning() -> None:
    told = Told()
    for step in range(30):
        told.tick(saturated=step > 0)
        told.wait(0.1)
    assert [one["level"] for one in told.facts["problems"]] == ["warn"]
    assert "limit" in told.facts["problems"][0]["text"]
    told.tick()
    assert told.facts["level"] == "ok"


def test_the_worst_of_all_diagnostics_comes_first_whoever_tells_it() -> None:
    told = Told()
    told.tick()
    told.report(CONTROLLER, 1, "2 ticks late or missing")
    told.report("battery", 2, "empty", hardware="robot7")
    told.report(TUNER)
    assert [one["text"] for one in told.facts["problems"]] == ["empty", "2 ticks late or missing"]
    assert told.facts["level"] == "error"
    assert [one["name"] for one in told.health.diagnostics()] == ["battery", CONTROLLER, TUNER]


def test_nodes_that_fall_silent_are_told_and_others_are_not_watched() -> None:
    told = Told()
    told.report("/plant_simulator")
    told.report(TUNER, text="idle", adaptation="off")
    told.report("battery", hardware="robot7")
    assert told.facts["adaptation"] == "off"
    told.wait(OUTDATED + 0.5)
    told.tick()
    assert {(one["who"], one["level"]) for one in told.facts["problems"]} == {
        ("/plant_simulator", "error"), (TUNER, "warn"),
    }  # fmt: skip
    assert told.facts["adaptation"] is None
    told.wait(FORGOTTEN)
    told.tick()
    assert told.facts["level"] == "ok"


def test_signals_without_a_controller_have_ages_of_their_own() -> None:
    told = Told()
    told.health.take_signal("measurement", 3.0)
    told.wait(0.4)
    assert told.facts["values"]["measurement"] == 3.0
    assert told.facts["ages"] == {"measurement": 0.4, "setpoint": None}
    told.wait(2.0)
    assert told.facts["values"]["measurement"] is None
    assert told.facts["ages"]["measurement"] == 2.4
