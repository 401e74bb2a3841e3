"""When things go wrong around the controller it tells, keeps its output finite, and goes on."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.srv import GetState
from rclpy.node import Node
from rosgraph_msgs.msg import Clock as ClockMessage
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from fopid_core.model.fopid import Fopid
from fopid_core.runtime.controller import ControllerSettings, FopidController
from fopid_msgs.msg import FopidState, ScalarStamped

from ..conftest import Graph
from .fed import PERIOD, FedController, LockstepByHand, stamped

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
GAINS = {"kp": 1.0, "ki": 0.1}
LARGEST_STEP = 0.1 * 1.0 * PERIOD * 1.01
"""What the integral may add in one tick: ki times an error of at most 1 times the sample time."""


def steps_after_holds(states: list[FopidState]) -> list[float]:
    """How far the control moved at each first tick after an input was stale."""
    return [
        abs(after.control - before.control) for before, after in pairwise(states) if before.stale and not after.stale
    ]


@pytest.mark.parametrize("silent", ["measurement", "setpoint"])
def test_a_stale_input_holds_the_control_and_comes_back_without_a_bump(graph: Graph, silent: str) -> None:
    fed = FedController(graph, {**GAINS, f"{silent}_timeout": 0.2})
    fed.run(setpoint=1.0, sensor=0.5)
    if silent == "measurement":
        fed.sensor = None
    else:
        fed.setpoint = None
    held = fed.wait(lambda state: state.stale).control
    assert held == pytest.approx(0.5, abs=0.2)
    fed.diagnosed(ERROR, f"{silent} stale")
    assert fed.states[-1].stale
    assert fed.states[-1].control == held
    assert fed.states[-1].measurement_age > (0.2 if silent == "measurement" else 0.0)
    fed.run(setpoint=1.0, sensor=0.2)  # the proportional part alone would jump by 0.3
    assert max(steps_after_holds(fed.states)) < LARGEST_STEP
    fed.recovered()


def test_a_stale_measurement_leads_to_the_safe_control_within_the_rate_limit(graph: Graph) -> None:
    fed = FedController(graph, {**GAINS, "measurement_timeout": 0.2, "on_stale": "safe", "safe_control": -0.4,
                                "control_rate_max": 2.0})  # fmt: skip
    fed.run(setpoint=1.0, sensor=0.5)
    fed.wait(lambda state: state.control > 0.4)
    fed.sensor = None
    fed.wait(lambda state: state.stale and state.control == -0.4)
    moves = [abs(b.control - a.control) for a, b in pairwise(fed.states)]
    assert max(moves) <= 2.0 * PERIOD * (1 + 1e-9)
    fed.run(setpoint=1.0, sensor=0.2)
    assert max(steps_after_holds(fed.states)) < LARGEST_STEP


def test_a_stale_measurement_hands_over_to_a_person_when_told_to(graph: Graph) -> None:
    fed = FedController(graph, {**GAINS, "measurement_timeout": 0.2, "on_stale": "manual"})
    fed.run(setpoint=1.0, sensor=0.5)
    fed.publishers["manual_control"].publish(ScalarStamped(value=7.0))  # before it counts
    graph.spin(0.1)
    fed.sensor = None
    held = fed.wait(lambda state: state.stale).control
    assert held < 1.0

    def driven(state: FopidState) -> bool:
        fed.publishers["manual_control"].publish(ScalarStamped(value=0.9))
        return state.control == 0.9

    fed.wait(driven)
    assert fed.states[-1].stale
    fed.run(setpoint=1.0, sensor=0.2)
    assert max(steps_after_holds(fed.states)) < LARGEST_STEP


def test_in_manual_mode_a_person_drives_without_setpoint_and_measurement(graph: Graph) -> None:
    fed = FedController(graph, {**GAINS, "mode": "manual"})

    def driven(state: FopidState) -> bool:
        fed.publishers["manual_control"].publish(ScalarStamped(value=0.6))
        return state.control == 0.6

    assert math.isnan(fed.wait(driven).measurement)
    assert graph.set("fopid_controller", mode="auto").successful
    fed.run(setpoint=1.0, sensor=0.5)
    first = next(state for state in fed.states if not state.stale)
    assert abs(first.control - 0.6) < LARGEST_STEP


def core_controller(**more: object) -> FopidController:
    return FopidController(ControllerSettings(Fopid(kp=1.0, ki=0.1), sample_time=PERIOD, **more))


def test_in_lockstep_a_value_that_is_not_finite_is_replaced_by_the_last_until_it_is_too_old(graph: Graph) -> None:
    loop = LockstepByHand(graph, {**GAINS, "measurement_timeout": 3 * PERIOD})
    expected = core_controller()
    loop.send("setpoint", 1.0)
    bad = (math.nan, math.inf, -math.inf, math.nan, math.nan, 1e300)
    for sample, measurement in enumerate((0.2, 0.3, *bad, 0.4, 0.5)):
        answer = loop.tick(sample, measurement)
        too_old = 5 <= sample < 8  # the last good one is of sample 1
        kept = 0.3 if 2 <= sample < 8 else measurement
        assert answer == (expected.hold() if too_old else expected.step(1.0, kept))
        assert loop.states[-1].stale == too_old
        assert loop.states[-1].refused == min(max(sample - 1, 0), 6)
    loop.graph.until(lambda: loop.facts.get("other values refused") == "6", "a report of all of them")
    told = [report.status[0] for report in loop.diagnostics]
    # While the last good one is too old as well, the level is that of the worse.
    assert any(status.level in (WARN, ERROR) and "values refused" in status.message for status in told)
    assert loop.facts["stale ticks"] == "3"
    assert "measurement = nan" in graph.logs()


@pytest.mark.parametrize("policy", ["hold", "safe", "manual"])
def test_in_lockstep_a_setpoint_ages_with_the_loop(graph: Graph, policy: str) -> None:
    parameters = {**GAINS, "setpoint_timeout": 2.5 * PERIOD, "on_stale": policy, "safe_control": -0.5}
    loop = LockstepByHand(graph, parameters)
    expected = core_controller(safe_control=-0.5)
    loop.send("setpoint", 1.0)
    for sample in range(6):
        if sample == 4:
            loop.send("manual_control", 0.25)
        held = {"hold": None, "safe": -0.5, "manual": 0.25 if sample >= 4 else None}[policy]
        control = expected.step(1.0, 0.3) if sample < 3 else expected.hold(held)
        assert loop.tick(sample, 0.3) == control
    loop.send("setpoint", 2.0)
    assert loop.tick(6, 0.3) == expected.step(2.0, 0.3)
    assert not loop.states[-1].stale


def test_in_lockstep_samples_that_never_came_are_counted(graph: Graph) -> None:
    loop = LockstepByHand(graph, GAINS)
    loop.send("setpoint", 1.0)
    for sample in (0, 1, 5, 6, 9):
        loop.tick(sample, 0.5)
    assert [state.overruns for state in loop.states] == [0, 0, 3, 3, 5]
    assert [state.sample_interval for state in loop.states] == pytest.approx([0.0, 0.01, 0.04, 0.01, 0.03])
    graph.until(lambda: loop.facts.get("overruns") == "5", "a report of all of them")  # they may fall into two seconds
    told = [report.status[0] for report in loop.diagnostics if "late or missing" in report.status[0].message]
    assert {status.level for status in told} == {WARN}


def test_in_lockstep_a_sample_sent_twice_is_answered_alike_and_counts_once(graph: Graph) -> None:
    loop = LockstepByHand(graph, GAINS)
    expected = core_controller()
    loop.send("setpoint", 1.0)
    assert loop.tick(0, 0.5) == expected.step(1.0, 0.5)
    message = stamped(0.5, 0)
    for _ in range(2):
        loop._publishers["measurement"].publish(message)
    graph.until(lambda: len(loop.controls) == 3, "three answers")
    assert len({control.value for control in loop.controls}) == 1
    assert loop.tick(1, 0.5) == expected.step(1.0, 0.5)


def test_in_lockstep_time_that_runs_backwards_starts_the_controller_anew(graph: Graph) -> None:
    loop = LockstepByHand(graph, {**GAINS, "setpoint_timeout": 1.0})
    loop.send("setpoint", 1.0)
    first = [loop.tick(sample, 0.5) for sample in range(5, 8)]
    assert [loop.tick(sample, 0.5) for sample in range(3)] == first
    assert not any(state.stale for state in loop.states)
    loop.diagnosed(WARN, "time ran backwards")
    assert "starts anew" in graph.logs()


def test_gains_times_signals_beyond_a_number_give_the_safe_control_and_never_nan(graph: Graph) -> None:
    loop = LockstepByHand(graph, {"kp": 1e99, "ki": -1e99, "kd": 1e99, "mu": 2.0, "safe_control": 0.25})
    for sample, (setpoint, measurement) in enumerate([(1e99, -1e99), (-1e99, 1e99)] * 4):
        loop.send("setpoint", setpoint)
        loop.tick(sample, measurement)
    assert all(math.isfinite(control.value) for control in loop.controls)
    assert graph.set("fopid_controller", kp=1.0, ki=0.0, kd=0.0).successful
    assert graph.call(Trigger, "fopid_controller/reset").success
    loop.send("setpoint", 1.0)
    assert loop.tick(9, 0.5) == 0.5


def test_the_state_of_a_loop_that_diverges_is_told_as_it_is_and_what_is_not_known_is_nan(graph: Graph) -> None:
    loop = LockstepByHand(graph, {"kp": 1e10, "ki": 1.0, "safe_control": 0.25})
    loop.send("setpoint", 1.0)
    loop.tick(0, -6.9e80)
    assert (loop.states[-1].measurement, loop.states[-1].proportional) == (-6.9e80, 6.9e90)
    assert loop.tick(1, -6.9e95) == 0.25  # 6.9e105 is beyond what is reckoned with: the safe control
    told = loop.states[-1]
    assert (told.setpoint, told.measurement, told.error, told.control) == (1.0, -6.9e95, 6.9e95, 0.25)
    assert told.control_unlimited == told.proportional + told.integral + told.derivative == pytest.approx(6.9e105)
    assert told.saturated
    for sample in range(2, 20):  # from here on the measurement is refused, and after 0.1 s stale
        loop.tick(sample, -6.9e109)
    stale = loop.states[-1]
    assert stale.stale
    assert (stale.setpoint, stale.measurement, stale.control) == (1.0, -6.9e95, 0.25)
    assert all(map(math.isnan, (stale.proportional, stale.integral, stale.derivative)))
    assert not any(state.measurement == 0.0 or state.proportional == 0.0 for state in loop.states)


def test_a_stamp_that_goes_back_is_refused_once_and_a_clock_set_back_is_followed(graph: Graph) -> None:
    fed = FedController(graph, {"kp": 1.0})
    fed.setpoint = 0.0

    def send(value: float, stamp: float) -> None:
        fed.publishers["measurement"].publish(stamped(value, round(stamp * 1e9)))

    def taken(value: float, stamp: float) -> bool:
        send(value, stamp)
        return bool(fed.states) and fed.states[-1].measurement == value

    graph.until(lambda: taken(1.0, 10.0), "the first sample")
    for count, (refused, stamp) in enumerate([(5.0, 9.9), (6.0, 3.0)], 1):
        send(refused, stamp)
        graph.until(lambda count=count: fed.facts.get("time ran backwards") == str(count), "a count of it")
        assert fed.states[-1].measurement == count
        graph.until(lambda count=count, stamp=stamp: taken(count + 1.0, stamp + 0.1), "the next sample")
    assert "the measurement's stamp ran backwards" in graph.logs()


def test_a_sample_repeated_with_its_old_stamp_grows_stale(graph: Graph) -> None:
    fed = FedController(graph, {**GAINS, "measurement_timeout": 0.3})
    fed.setpoint = 1.0

    def repeated_until(ready: Callable[[FopidState], bool]) -> bool:
        fed.publishers["measurement"].publish(stamped(0.5, 10**9))
        return any(map(ready, fed.states))

    graph.until(lambda: repeated_until(lambda state: not state.stale), "a sample that counts")
    graph.until(lambda: repeated_until(lambda state: state.stale and state.measurement_age > 1.5), "a stale one")


class SimulatedTime:
    """/clock and a sensor in step with it, for a controller with use_sim_time."""

    def __init__(self, fed: FedController) -> None:
        self.fed, self.graph = fed, fed.graph
        self.publisher = self.graph.node.create_publisher(ClockMessage, "/clock", 10)
        self.graph.until(self.publisher.get_subscription_count, "a reader of /clock")

    def run(self, begin: float, samples: int = 20) -> None:
        """Let time run from ``begin`` until this many ticks have come."""
        message, self.sample, ticks = ClockMessage(), 0, len(self.fed.states)
        begin_ns = round(begin * 1e9)

        def ticked() -> bool:
            message.clock.sec, message.clock.nanosec = divmod(begin_ns + self.sample * 10_000_000, 10**9)
            self.publisher.publish(message)
            self.sample += 1
            return len(self.fed.states) >= ticks + samples

        self.graph.until(ticked, f"{samples} ticks")


def test_a_simulated_clock_may_stop_jump_and_run_backwards(graph: Graph) -> None:
    fed = FedController(graph, {**GAINS, "use_sim_time": True, "measurement_timeout": 1.0})
    fed.setpoint, fed.sensor = 1.0, 0.5
    clock = SimulatedTime(fed)
    clock.run(10.0)

    fed.diagnosed(WARN, "no ticks")  # it stands
    ticks = len(fed.states)
    assert graph.call(GetState, "fopid_controller/get_state").current_state.label == "active"
    assert len(fed.states) == ticks

    clock.run(100.0)
    assert fed.states[-1].overruns > 8000
    assert fed.states[-1].header.stamp.sec == 100
    clock.run(20.0)
    assert fed.states[-1].header.stamp.sec == 20
    assert "time ran backwards: the controller starts anew" in graph.logs()
    clock.run(0.0)
    assert all(math.isfinite(control.value) for control in fed.controls)


SHIM = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#define SLICE 10000000L

static long shift(void) {  /* seconds by which the file's owner has set the system clock on or back */
    static const volatile long *shared;
    if (!shared) {
        int file = open(getenv("CLOCK_SHIFT"), O_RDONLY);
        shared = mmap(0, sizeof *shared, PROT_READ, MAP_SHARED, file, 0);
        close(file);
    }
    return *shared;
}

int clock_gettime(clockid_t id, struct timespec *now) {
    int failed = syscall(SYS_clock_gettime, id, now);
    if (!failed && id == CLOCK_REALTIME) now->tv_sec += shift();
    return failed;
}

int gettimeofday(struct timeval *now, void *zone) {
    int failed = syscall(SYS_gettimeofday, now, zone);
    if (!failed) now->tv_sec += shift();
    return failed;
}

/* A wait until an instant of the system clock ends when that clock says so, whenever it was set. */
#define WAIT(name, parameters, arguments, failed)                                                   \
    int name parameters {                                                                           \
        static int (*real) parameters;                                                              \
        if (!real) real = dlsym(RTLD_NEXT, #name);                                                  \
        const struct timespec *until = last;                                                        \
        if (until->tv_sec < 1000000000) return real arguments; /* of the steady clock */            \
        for (;;) {                                                                                  \
            struct timespec now, slice;                                                             \
            clock_gettime(CLOCK_REALTIME, &now);                                                    \
            double left = (until->tv_sec - now.tv_sec) * 1e9 + (until->tv_nsec - now.tv_nsec);      \
            long nanoseconds = left < 0 ? 0 : left < SLICE ? (long)left : SLICE;                    \
            syscall(SYS_clock_gettime, CLOCK_REALTIME, &slice);                                     \
            slice.tv_sec += (slice.tv_nsec + nanoseconds) / 1000000000;                             \
            slice.tv_nsec = (slice.tv_nsec + nanoseconds) % 1000000000;                             \
            last = &slice;                                                                          \
            int ended = real arguments;                                                             \
            if (!failed || left <= 0) return ended;                                                 \
        }                                                                                           \
    }

WAIT(pthread_cond_timedwait, (pthread_cond_t *condition, pthread_mutex_t *mutex, const struct timespec *last),
     (condition, mutex, last), (ended == ETIMEDOUT))
WAIT(pthread_mutex_timedlock, (pthread_mutex_t *mutex, const struct timespec *last), (mutex, last),
     (ended == ETIMEDOUT))
WAIT(sem_timedwait, (sem_t *semaphore, const struct timespec *last), (semaphore, last),
     (ended == -1 && errno == ETIMEDOUT))
"""
"""Preloaded into the controller, it stands for a system clock that somebody sets."""


class SystemClock:
    """The system clock as a node sees it that was started with ``environment``."""

    def __init__(self, folder: Path) -> None:
        source, library, self._file = folder / "shift.c", folder / "shift.so", folder / "shift"
        source.write_text(SHIM)
        self.shift(0)
        subprocess.run(["gcc", "-shared", "-fPIC", "-O1", source, "-o", library, "-ldl"], check=True)
        self.environment = {"LD_PRELOAD": str(library), "CLOCK_SHIFT": str(self._file)}

    def shift(self, seconds: int) -> None:
        with self._file.open("r+b" if self._file.exists() else "wb") as file:
            file.write(seconds.to_bytes(8, "little", signed=True))


def test_ticks_go_on_when_the_system_clock_is_set(graph: Graph, tmp_path: Path) -> None:
    clock = SystemClock(tmp_path)
    graph.environment.update(clock.environment)
    fed = FedController(graph, {**GAINS, "measurement_timeout": 5.0})
    fed.run(setpoint=1.0, sensor=0.5)
    for shift in (3600, -3600, 0):
        clock.shift(shift)
        now = time.time()
        fed.wait(lambda state, then=now + shift: abs(state.header.stamp.sec - then) < 60)
        before = len(fed.states)
        graph.until(lambda before=before: len(fed.states) > before + 20, "ticks")
    intervals = [state.sample_interval for state in fed.states[1:]]
    assert 0 < min(intervals) <= max(intervals) < 5.0
    assert not any(state.stale for state in fed.states[1:])
    controls = [state.control for state in fed.states[1:]]
    assert max(abs(b - a) for a, b in pairwise(controls)) < 0.1


def test_a_controller_that_was_stopped_counts_the_ticks_it_missed_and_goes_on(graph: Graph) -> None:
    fed = FedController(graph, GAINS)
    fed.run(setpoint=1.0, sensor=0.5)
    before, told = fed.states[-1].overruns, len(fed.states)
    fed.process.send_signal(signal.SIGSTOP)
    time.sleep(0.5)  # what it misses
    fed.process.send_signal(signal.SIGCONT)
    fed.wait(lambda state: state.overruns >= before + 45)
    assert max(state.sample_interval for state in fed.states[told:]) > 0.45
    fed.wait(lambda state: state.sample_interval < 2 * PERIOD)
    graph.until(lambda: int(fed.facts.get("overruns", "0")) >= 45, "a count in the diagnostics")
    graph.until(lambda: float(fed.facts["rate [1/s]"]) > 50, "a rate in the diagnostics")


@pytest.mark.slow
def test_two_publishers_on_one_topic_are_named_once_in_the_log_and_in_the_diagnostics(graph: Graph) -> None:
    fed = FedController(graph, GAINS)
    fed.run(setpoint=1.0, sensor=0.5)
    fed.recovered()
    rival = Node("rival", namespace="/other", context=graph.context)
    graph.executor.add_node(rival)
    publisher = rival.create_publisher(ScalarStamped, "/measurement", 1)
    fed.diagnosed(ERROR, "measurement is published by /other/rival and /tester")
    seen = len(fed.diagnostics)
    graph.until(lambda: len(fed.diagnostics) > seen + 1, "two more reports")
    assert graph.logs().count("measurement is published by") == 1
    rival.destroy_publisher(publisher)
    fed.recovered()
    rival.create_publisher(ScalarStamped, "/control", 1)
    fed.diagnosed(ERROR, "control is published by /fopid_controller and /other/rival")
    rival.destroy_node()


def test_an_array_that_is_too_short_at_times_is_counted_and_the_loop_runs_on(graph: Graph) -> None:
    joint = {"measurement.type": "sensor_msgs/msg/JointState", "measurement.field": "position[1]"}
    controls = graph.listen(ScalarStamped, "control")
    graph.start("fopid_controller", {"kp": 2.0, **joint})
    measurement = graph.node.create_publisher(JointState, "measurement", 1)
    setpoint = graph.node.create_publisher(ScalarStamped, "setpoint", 1)

    def answers(position: list[float], value: float) -> bool:
        measurement.publish(JointState(position=position))
        setpoint.publish(ScalarStamped(value=1.0))
        return bool(controls) and controls[-1].value == value

    graph.until(lambda: answers([9.0, 0.5], 1.0), "2 * (1 - 0.5)")
    graph.until(lambda: answers([9.0], 1.0) and "position[1]" in graph.logs(), "a warning")
    graph.until(lambda: answers([9.0, 0.75], 0.5), "2 * (1 - 0.75)")


@pytest.mark.slow
def test_a_plant_killed_and_started_again_is_controlled_again(graph: Graph) -> None:
    parameters = {"process": "P4", "sample_time": 0.01}
    plant = graph.start("plant_simulator", parameters)
    states = graph.listen(FopidState, "fopid_controller/state")
    graph.start("fopid_controller", {"kp": 1.4, "ki": 2.6, "measurement_timeout": 0.3, "on_stale": "safe"})
    setpoint = graph.node.create_publisher(ScalarStamped, "setpoint", 1)

    def at_setpoint() -> bool:
        setpoint.publish(ScalarStamped(value=1.0))
        return bool(states) and abs(states[-1].measurement - 1.0) < 0.05

    graph.until(at_setpoint, "a loop at its setpoint")
    os.kill(plant.pid, signal.SIGKILL)
    graph.until(lambda: states[-1].stale and states[-1].control == 0.0, "the safe control")
    graph.start("plant_simulator", parameters)
    graph.until(lambda: not states[-1].stale and states[-1].measurement < 0.5, "the new plant")
    graph.until(at_setpoint, "a loop at its setpoint again")


@pytest.mark.slow
def test_in_lockstep_a_plant_killed_and_started_again_begins_the_same_run_anew(graph: Graph) -> None:
    parameters = {"process": "P1", "sample_time": 0.01, "trigger": "lockstep", "advance_until": 2.0}
    controls = graph.listen_once(ScalarStamped, "control")
    setpoint = graph.node.create_publisher(ScalarStamped, "setpoint", 1)
    graph.start("fopid_controller", {**GAINS, "trigger": "lockstep", "sample_time": 0.01})
    graph.until(setpoint.get_subscription_count, "the controller")
    setpoint.publish(ScalarStamped(value=1.0))
    graph.until(lambda: graph.node.count_publishers("control"), "the controller")
    graph.spin(0.3)
    plant = graph.start("plant_simulator", parameters)
    graph.until(lambda: len(controls) == 200, "a run")
    os.kill(plant.pid, signal.SIGKILL)
    graph.start("plant_simulator", parameters)
    graph.until(lambda: len(controls) == 400, "the second run")
    values = [control.value for control in controls]
    assert values[200:] == values[:200]
