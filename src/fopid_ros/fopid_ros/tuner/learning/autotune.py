"""One autotuning of a running loop: excite, identify, tune, verify, apply, watch; and undo it all when told to."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

from fopid_core.design.identification.flaws import Flaws
from fopid_core.design.identification.identify import IdentificationResult, behind_slow_actuator, identify
from fopid_core.design.identification.noise import hidden_by_steps
from fopid_core.design.identification.record import FEWEST_SAMPLES, Record
from fopid_core.design.identification.sensor_faults import as_told, without_dropouts
from fopid_core.design.proof_verification import near_instability
from fopid_core.design.response_verification import bears_out, contradicts_rest, doubt_of
from fopid_core.design.slower import act_alike
from fopid_core.design.specification import TuningResult
from fopid_core.design.sufficiency import Sufficiency
from fopid_core.errors import InputError
from fopid_core.runtime.performance_monitor import LoopPerformance
from fopid_core.runtime.settings import Pace
from fopid_ros.tuner.controller_client import ControllerClient
from fopid_ros.tuner.learning.announcement import planned
from fopid_ros.tuner.learning.autotune_request import AutotuneRequest
from fopid_ros.tuner.learning.closed_loop_experiment import ClosedLoopExperiment
from fopid_ros.tuner.learning.gain_update import (
    GainUpdate,
    Outcome,
    Trial,
    counting_as_none,
    response_time,
)
from fopid_ros.tuner.learning.large_moves import needed_pace
from fopid_ros.tuner.learning.loop_baseline import LoopBaseline, quieter
from fopid_ros.tuner.learning.loop_tap import LoopTap, Tick
from fopid_ros.tuner.learning.loop_wait import LoopWait, OpenLoopError, Stage
from fopid_ros.tuner.learning.proof import Proof
from fopid_ros.tuner.learning.reach import NOT_MOVED, Reach
from fopid_ros.tuner.learning.rest import RestlessError
from fopid_ros.tuner.learning.running_controller import RunningController, read_running_controller
from fopid_ros.tuner.learning.sensor_faults import LoneSample

EXPERIMENTS = 3
"""How often the experiment is made while its record says too little."""
MOVED_SHARE = 0.5
"""The share of the allowed deviation that new gains may cause."""
LIVELIER = 5.0
"""Gains that act so many times as strongly as before, where a controller would, make a loop that works where the record
of the loop before hardly shows the process."""
MORE_MOVEMENT = 3.0
"""What a second round may aim at of the control's movement from noise, in what was aimed at before."""
NO_TIME = "gains are to be had that hold the setpoint better, for which no time was left: autotune once more"
"""What is said instead of a second round."""
AGREE = 1.5
"""Pulses may make an actuator look so many times slower than the slowest that small moves left possible."""
RESTS = 4
"""How often rest is waited for after gains that the loop did not bear, each time for a length of the experiment."""
SLOWER = (0.7, 0.5, 0.35)
"""How much slower the last gains of another kind that the loop did not bear are tried again, in turn."""


class Autotuner:
    """Runs one autotuning in the calling thread, while others spin the node.

    Where the record does not show the process's slow end, gains are held back. A second round follows then with them,
    and both rounds' signals are learnt from together, unless only the second's bear a process out. So it does where the
    gains are much livelier: such a loop shows the process where it works, and is learnt from alone. Either aims at no
    more than ``MORE_MOVEMENT`` of the first.

    References
    ----------
    Lee, W. S., Anderson, B. D. O., Kosut, R. L., Mareels, I. M. Y. A new approach to adaptive robust control. Int. J.
    Adaptive Control and Signal Processing 7 (1993) 183-211: the bandwidth widened in rounds.

    Parameters
    ----------
    tap : LoopTap
    client : ControllerClient
    request : AutotuneRequest
    wait : LoopWait
        Tells how it goes, and whether an end has been asked for.
    before : Reach
        How far the measurement was moved when the running gains were learnt; it is moved as far again.

    Raises
    ------
    InputError
        If it cannot be begun: no controller, no loop, or something in the request.
    """

    def __init__(
        self, tap: LoopTap, client: ControllerClient, request: AutotuneRequest, wait: LoopWait,
        before: Reach = NOT_MOVED,
    ) -> None:  # fmt: skip
        self._tap, self._client, self._request, self._wait = tap, client, request, wait
        self._updates: list[GainUpdate] = []
        self._learnt: tuple[IdentificationResult, Record] | None = None
        self._shown: list[tuple[IdentificationResult, Record]] = []
        self._smaller: list[Record] = []
        self._second_began = math.nan
        self._take_for(read_running_controller(client), before)
        self._rest = self._experiment.loop

    def _take_for(self, controller: RunningController, before: Reach, noise_gain_aim: float = math.inf) -> None:
        """Begin a round with the controller as it runs."""
        self._controller, loop, asked = controller, LoopBaseline(controller), self._request
        self._experiment = ClosedLoopExperiment(self._tap, self._wait, loop, asked.experiment, before)
        self._gain_update = GainUpdate(self._tap, self._client, self._wait, controller, asked.criteria, noise_gain_aim)
        self._updates.append(self._gain_update)

    def plan(self) -> tuple[list[str], float]:
        """What ``run`` will do, a line for each phase, and how long that takes [s]; the loop is left alone."""
        return planned(self._request, self._experiment, self._controller.sample_time, self._has_a_second_round)

    @property
    def reach(self) -> Reach:
        """How far the measurement has been moved, for another goal."""
        return replace(self._experiment.reach, most=math.inf)

    @property
    def _has_a_second_round(self) -> bool:
        """Where nobody has said how long it is to take, nor that nothing is to be applied."""
        asked = self._request
        return asked.second_round and self._experiment.ends_when_known and not asked.propose_only

    def _calls_for_another(self, outcome: Outcome) -> bool:
        """Whether the new gains are such that a second round follows."""
        return outcome.held_back or self._is_livelier(outcome)

    def _is_livelier(self, outcome: Outcome, before: RunningController | None = None) -> bool:
        """Whether new gains act far more strongly than those before, or than those that run now."""
        tuning = outcome.tuning
        if outcome.model is None or tuning is None or tuning.controller is None:
            return False
        s = 1j * outcome.model.crossover
        return abs(complex(tuning.controller(s))) >= LIVELIER * abs(complex((before or self._controller).gains(s)))

    def run(self) -> Outcome:
        """Do it; however it ends, the loop is left with gains that are known to hold it.

        Raises
        ------
        InputError
            If the loop does not rest, or something else is amiss.
        OpenLoopError
            If it stands still, or its controller does not close it.
        CancelledError
            After everything has been put back.
        """
        try:
            self._tap.begin_injection()
            outcome = self._run()
            return self._try_others(outcome) if outcome.rolled_back else outcome
        except BaseException as error:
            put_back = [update.roll_back() for update in reversed(self._updates)]
            if any(put_back) and isinstance(error, InputError | OpenLoopError):
                raise InputError(f"{error}; the gains from before are back") from error
            raise
        finally:
            self._client.end_trial()
            self._tap.history.whole_since = math.inf
            self._tap.end_injection()

    def _run(self) -> Outcome:
        self._experiment.measure()
        if self._request.trial is not None:
            return self._try_out(self._request.trial)
        began = self._tap.history.whole_since = self._experiment.learnt_since
        self._wait.begin_round("", (0.0, 0.5 if self._has_a_second_round else 1.0))
        first = self._make_round(began, self._has_a_second_round)
        if first.applied and self._has_a_second_round and self._calls_for_another(first):
            return self._once_more(first, began)
        return self._prove(first, self._gain_update, self._experiment.furthest)

    def _make_round(self, began: float, another: bool = False) -> Outcome:
        """Excite, learn from all that was heard since ``began``, and apply what is better than what runs.

        ``another`` may follow, where the gains call for it.
        """
        outcome, sufficiency = Outcome(), self._sufficiency()

        def is_over() -> bool:
            if self._tap.history.ticks_since(began) < FEWEST_SAMPLES:
                return False
            heard = self._behind_actuator(self._heard(began))
            return sufficiency.is_over(heard, self._experiment.may_widen, self._experiment.content)

        for _ in range(EXPERIMENTS):
            ended = self._experiment.excite(is_over)
            if ended:
                outcome = Outcome(message=f"the experiment was stopped, nothing was changed: {ended}")
                widened = self._experiment.widen_after_escape()
            else:
                excited_until = self._experiment.newest
                outcome = self._learn(began)
                self._experiment.latest += self._experiment.newest - excited_until  # working out moves nothing
                widened = self._experiment.fits and outcome.tuned is None and self._experiment.widen()
            if outcome.success or (ended and not widened) or not self._experiment.fits:
                break
            # What hid the process in smaller moves would do so again: it is learnt from alone.
            if widened:
                self._smaller.append(self._heard(began))
                began, sufficiency = self._tap.history.newest_time("control"), self._sufficiency()
        if not outcome.success or self._request.propose_only:
            return outcome
        self._experiment.settle("applying", 0.72)
        return self._apply(self._gain_update, outcome, another and self._calls_for_another(outcome))

    def _apply(self, update: GainUpdate, outcome: Outcome, another: bool = False) -> Outcome:
        """Gains on trial, watched; before it is told how long that takes, with what follows."""
        tuning = outcome.tuning
        if another or tuning is None or tuning.controller is None:
            then = "; then a second round" * another
            return update.apply_and_monitor(outcome, *self._what_is_borne(), then=then)
        loop = LoopBaseline(replace(self._controller, gains=tuning.controller))
        proof = Proof(self._tap, self._wait, loop, self._request.experiment, self._experiment.reach, self._rest)
        seconds = proof.usual_time(response_time(outcome))
        return update.apply_and_monitor(outcome, *self._what_is_borne(), proof=seconds)

    def _sufficiency(self) -> Sufficiency:
        return Sufficiency(self._request.template, self._experiment.loop.unrest, self._controller.sample_time)

    def _once_more(self, first: Outcome, began: float) -> Outcome:
        """A second round; where it comes to nothing, what the first came to stays, if the loop bears to be moved."""
        made, update = self._experiment, self._gain_update
        self._take_for(read_running_controller(self._client), made.reach, MORE_MOVEMENT * first.noise_gain_aim)
        self._experiment.latest = made.latest
        if not self._experiment.fits:
            self._experiment, self._gain_update = made, update
            first = replace(first, message=f"{first.message}; {NO_TIME}")
            return self._prove(first, update, made.furthest)
        self._wait.begin_round("second round", (0.5, 1.0))
        try:
            self._experiment.measure(made.furthest, announced=False)
            self._second_began = self._experiment.learnt_since
            second = self._make_round(began if first.held_back else self._second_began)
        except RestlessError as error:
            return self._taken_back(first, update, str(error))
        except InputError as error:
            self._gain_update.roll_back()
            second = Outcome(message=str(error))
        escaped = self._experiment.escaped
        if escaped and not self._experiment.comes_back():
            return self._taken_back(first, update, escaped)
        second = self._prove(second, self._gain_update, made.furthest)
        if second.applied:
            kept = f"; {counting_as_none(first.deadband)}" if self._rest.controller.deadband < first.deadband else ""
            return replace(second, previous=first.previous, message=f"in a second round: {second.message}{kept}")
        first = replace(first, message=f"{first.message}; a second round changed nothing: {second.message}")
        return self._prove(first, update, made.furthest if escaped else math.inf)

    def _prove(self, outcome: Outcome, update: GainUpdate, borne: float = math.inf) -> Outcome:
        """Move the loop as far as it was moved for the new gains; where it swings on, those from before come back.

        So they do where it goes further from the setpoint than is borne while it comes to rest before. Until then the
        new ones are on trial.
        """
        return update.kept(self._proved(outcome, update, borne)) if outcome.applied else outcome

    def _proved(self, outcome: Outcome, update: GainUpdate, borne: float) -> Outcome:
        self._wait.begin_round("proof", (0.95, 1.0))
        pace = None
        try:
            running = LoopBaseline(read_running_controller(self._client))
            asked, reach = self._request.experiment, self._experiment.reach
            proof = Proof(self._tap, self._wait, running, asked, reach, self._rest)
            proof.measure(borne, announced=False)
            moved_from = self._tap.history.newest_time("control")
            against = proof.prove(response_time(outcome)) or self._near_instability(outcome, moved_from)
            if not against:
                pace, against = self._borne_in_large_moves(outcome, running, proof)
        except RestlessError as error:
            against = str(error)
        except InputError as error:
            return replace(outcome, message=f"{outcome.message}; not moved once more: {error}")
        if against:
            return self._taken_back(outcome, update, against)
        return outcome if pace is None else self._held(outcome, update, proof, pace)

    def _near_instability(self, outcome: Outcome, moved_from: float) -> str:
        """What speaks against new gains in what the loop showed as it was moved with them, and in all that was heard.

        Small moves may have hidden what these show, friction above all.
        """
        tuning, history, most = outcome.tuning, self._tap.history, self._request.criteria.limits.ms_max
        if tuning is None or tuning.controller is None or history.ticks_since(moved_from) < FEWEST_SAMPLES:
            return ""
        self._wait.report(Stage("watching", 0.95, message="what did it show as it was moved?"))
        self._shown.clear()

        def learnt(since: float) -> IdentificationResult:
            self._shown.append(self._identified(since))
            return self._shown[-1][0]

        gains, as_moved, tick = (tuning.controller, tuning.filter), learnt(moved_from), self._controller.sample_time
        against = near_instability(*gains, as_moved, lambda: learnt(history.whole_since), tick, most)
        if not against:
            self._shown.clear()
        return against

    def _held(self, outcome: Outcome, update: GainUpdate, proof: Proof, pace: Pace) -> Outcome:
        """Hold the controller to a pace, and move the loop with it; those from before come back if it swings on."""
        self._client.hold(pace)  # whoever does not hear that does not keep the gains
        outcome = outcome.held(pace)
        if math.isinf(pace.control):
            return outcome
        try:
            against = proof.prove(response_time(outcome))
        except InputError as error:
            return replace(outcome, message=f"{outcome.message}; not moved once more with that: {error}")
        return self._taken_back(outcome, update, against) if against else outcome

    def _borne_in_large_moves(self, outcome: Outcome, running: LoopBaseline, proof: Proof) -> tuple[Pace | None, str]:
        """The pace that new gains need, and what speaks against them; a few pulses show whether they need one.

        Where these make the actuator look far slower than small moves left possible it is something else that is amiss,
        friction or a gain that changes: to hold the controller back for that may drive the loop out. Where they cannot
        be made or judged, gains that seem to need a pace are not kept.
        """
        learnt = self._learnt
        pace, against = self._in_large_moves(outcome, running)
        if pace is None or outcome.model is None:
            return pace, against
        possible = self._rate
        try:
            against = proof.pulse(outcome.model.process, response_time(outcome))
            if not against:
                pace, against = self._in_large_moves(outcome, running)
        except InputError as error:
            against = f"it is not known how fast the actuator is: {error}"
        if pace is not None and math.isfinite(pace.control) and self._rate < possible / AGREE:
            self._learnt = learnt
            against = f"pulses are not answered as by an actuator of {possible:.3g} a second or more"
        return pace, against

    def _in_large_moves(self, outcome: Outcome, running: LoopBaseline) -> tuple[Pace | None, str]:
        """As `needed_pace`, where the actuator is as slow as all that was heard leaves possible."""
        rest, tuning = self._rest, outcome.tuning
        if self._learnt is None or tuning is None or not math.isfinite(rest.controller.control_range):
            return None, ""
        record = self._heard(self._tap.history.whole_since)
        slow = behind_slow_actuator(record, self._learnt[0], self._request.template, rest.unrest, possible=True)
        if slow is None:
            return None, ""
        self._learnt = slow, record
        return needed_pace(slow, tuning, rest, running.controller.pace)

    def _taken_back(self, outcome: Outcome, update: GainUpdate, against: str) -> Outcome:
        update.roll_back_or_raise()
        self._gain_update = update
        told = f"the previous gains are back, since with the new ones {against}"
        return replace(outcome, success=False, applied=False, rolled_back=True, message=told)

    def _try_others(self, failed: Outcome) -> Outcome:
        """Where the loop did not bear gains: some that are learnt from that as well, then those slower.

        Where it does not bear any of them, those from before stay.
        """
        if self._learnt is None or failed.tuning is None:
            return failed
        update, reach, not_borne = self._gain_update, self._experiment.reach, [failed]
        for said, design in self._others(update, not_borne):
            self._wait.begin_round("other gains", (0.95, 1.0))
            try:
                running = LoopBaseline(read_running_controller(self._client))
                self._experiment = ClosedLoopExperiment(self._tap, self._wait, running, self._request.experiment, reach)
                self._come_to_rest()
                outcome = design()
                if outcome.success:
                    outcome = self._apply(update, outcome)
                    outcome = self._prove(outcome, update, self._experiment.furthest)
            except InputError as error:
                update.roll_back()
                return replace(failed, message=f"{failed.message}; others were not tried to the end: {error}")
            if outcome.rolled_back:
                not_borne.append(outcome)
            if outcome.applied:
                return replace(outcome, message=f"{outcome.message}; {said} that came first: {failed.message}")
        return replace(failed, message=f"{failed.message}; others did not do either: {outcome.message}")

    def _come_to_rest(self) -> None:
        """Wait for it longer than usual, since other gains have moved the loop, and these may be slow."""
        for _ in range(RESTS - 1):
            try:
                return self._experiment.measure(announced=False)
            except RestlessError:
                continue
        return self._experiment.measure(announced=False)

    def _others(self, update: GainUpdate, not_borne: list[Outcome]) -> Iterator[tuple[str, Callable[[], Outcome]]]:
        """What else is tried: how it is called, and how it is made; what of it was not borne either is added."""
        as_moved = [shown for shown in self._shown if shown[0].success]
        for self._learnt in as_moved:
            yield "learnt from what was shown then, others than those", partial(self._designed, update, *self._learnt)
        if not as_moved:
            yield "learnt from that as well, others than those", partial(self._learn_anew, not_borne[0])
        if self._learnt and math.isfinite(self._rate):
            yield "for that actuator, others than those", partial(self._designed, update, *self._learnt)
        last, those = not_borne[-1].tuning, "those" if len(not_borne) == 1 else "others than those"
        if self._learnt is None or last is None:
            return
        for share in SLOWER:
            slower = partial(self._designed, update, *self._learnt, slower=(last, share))
            yield f"{share:g} times as fast as {those}", slower

    def _learn_anew(self, failed: Outcome) -> Outcome:
        """What all that was heard comes to, with what was not borne; nothing where it comes to that again."""
        outcome, swing = self._learn(self._tap.history.whole_since), self._gain_update.not_borne
        if outcome.tuned is None and math.isfinite(swing[0]):  # no process: the swing itself may show it
            self._tap.history.count_as_excitation(*swing)
            outcome = self._learn(self._tap.history.whole_since)
        new = outcome.tuning.controller if outcome.success and outcome.tuning else None
        old = failed.tuning.controller if failed.tuning else None
        if new is None or old is None or outcome.model is None:
            return outcome
        alike = act_alike(new, old, outcome.model.crossover)
        return replace(outcome, success=False, message=f"{new} would do the same") if alike else outcome

    @property
    def _rate(self) -> float:
        """How slow the actuator may be, for all that is known; infinite where nothing speaks for a limit."""
        return self._learnt[0].flaws.rate if self._learnt else math.inf

    def _behind_actuator(self, record: Record) -> Record:
        return Flaws(rate=self._rate).of_record(record) if math.isfinite(self._rate) else record

    def _heard(self, since: float) -> Record:
        return without_dropouts(self._tap.history.record(since))[0]

    def _identified(self, since: float) -> tuple[IdentificationResult, Record]:
        """A model of all that was heard since then, and that."""
        record, known, unrest = self._heard(since), self._rate, self._experiment.loop.unrest
        found = identify(self._behind_actuator(record), self._request.template, noise=unrest).with_limit(known)
        return behind_slow_actuator(record, found, self._request.template, unrest) or found, record

    def _learn(self, began: float) -> Outcome:
        """A model of all that was heard since ``began``, and gains for it.

        Where that contradicts the model, and a second round's signals alone bear out their own, it is of these.
        """
        self._wait.report(Stage("identifying", 0.6))
        found, record = self._identified(began)
        if self._second_began > began and found.best and doubt_of(found.behind_actuator(record), found.best):
            alone, later = self._identified(self._second_began)
            if alone.success and alone.best and bears_out(alone.behind_actuator(later), alone.best):
                found, record = alone, later
        if not found.success or found.best is None:
            told = f"nothing was changed: {found.message} ({self._experiment.made})"
            return Outcome(message=told, model=found.best, models=found.models)
        now = self._controller
        wrong = contradicts_rest(found.best.process, now.gains, now.sample_time, now.filter)
        if wrong:
            told = f"nothing was changed: {wrong}; record longer or with larger moves of the control"
            return Outcome(message=told, model=found.best, models=found.models)
        self._learnt = found, record
        return self._designed(self._gain_update, found, record)

    def _designed(
        self, update: GainUpdate, found: IdentificationResult, record: Record,
        slower: tuple[TuningResult, float] | None = None,
    ) -> Outcome:  # fmt: skip
        """Gains for what was learnt; or those of an earlier design, slower."""
        loop, every = self._experiment.loop, self._request.propose_only
        sensor = quieter(self._rest, loop).sensor
        outcome = update.design(
            found, sensor, loop.control_peak, loop.control_rate, loop.control,
            every=every, record=record, smaller=self._smaller, slower=slower,
        )  # fmt: skip
        # Between two steps an integral moves the control for ever, and a derivative makes it jump at each.
        deadband, told = hidden_by_steps(record.measurement, self._rest.noise, self._rest.moves), outcome.message
        told += as_told(record)[1]
        if every and outcome.success and deadband > self._controller.deadband:
            told = f"{told}; {counting_as_none(deadband, 'are to count')}"
        if outcome.success and self._is_livelier(outcome, self._rest.controller):
            within = f"the measurement was within {self._experiment.reach.moved:.3g} of {loop.setpoint:.4g}"
            told = (
                f"{told}; far livelier than what ran, and learnt while {within}: watch the loop where it goes further"
            )
        return replace(outcome, deadband=deadband, message=told)

    def _try_out(self, trial: Trial) -> Outcome:
        asked = Outcome(success=True, message=f"{trial.design.gains} as asked")
        return self._gain_update.kept(self._gain_update.try_out(trial, asked, *self._what_is_borne()))

    def _what_is_borne(self) -> tuple[LoopPerformance, float, float, Callable[[Tick], str]]:
        """How the loop was, what is left of the experiment, by how much its error may grow, and what ends the watch."""
        loop, residual_transient = self._experiment.loop, self._experiment.residual_transient()
        furthest, sensor = self._experiment.furthest, LoneSample.within(loop.deviation_max)
        # New gains read the memory of the past anew, which moves the loop a little: that much is allowed.
        allowed = (MOVED_SHARE * loop.deviation_max) ** 2 / (loop.figures.mean_square + residual_transient**2)

        def outside(tick: Tick) -> str:
            seen = sensor.seen(tick.measurement)
            if tick.setpoint != loop.setpoint or abs(seen - tick.setpoint) <= furthest:
                return ""
            return f"measurement {seen:.4g} left the band of {furthest:.4g}"

        return loop.figures, residual_transient, max(allowed, 2.0), outside
