"""Which of several loops is best on a process, beside the gains that run and beside what the textbooks' rules make."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

from fopid_core.design.defaults import process_gain
from fopid_core.design.flaw_trial import UNLIMITED, FlawTrial
from fopid_core.design.identification.noise_spectrum import NoiseSpectrum
from fopid_core.design.loop_worth import LoopWorth, loop_worth, noise_gain
from fopid_core.design.robust_verification import RobustTuning, behind_hold
from fopid_core.design.specification import TuningRequest, TuningResult
from fopid_core.design.verification import control_rate
from fopid_core.errors import InputError
from fopid_core.model.evaluation import default_horizon
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process
from fopid_core.model.stability import stability
from fopid_core.model.two_degrees import NO_FILTER, WHOLE_SETPOINT, MeasurementFilter, SetpointWeights
from fopid_core.runtime.settings import UNPACED, AntiWindup, Pace

WORSE, BETTER = 1.05, 0.95
"""By which factor an index may grow, and to which both together must fall, so that new gains beat the old ones."""
LOAD_WEIGHT = 2.0 / 3.0
"""Of the load in what is best; the rest is the setpoint's."""
QUIET_WEIGHT, LEAST_SHARE = 0.2, 0.05
"""Half the movement is worth an eighth of the error, 2^-0.2, but no more load than is aimed at; below that share of
what is aimed at nobody feels it."""
PLAIN = 1.1
"""By which a derivative must pay, and so must orders that are not whole: the process is not known any better."""
HARDLY_MOVES = 0.05
"""Share of the movement that is allowed below which no rule's is worth to be met."""
AHEAD, AHEAD_IN_NOISE, SHORT_WEIGHT = 0.8, 0.6, 2.0
"""Of the rule of the textbooks with the least load error on the learnt process: the share of that error, and of its
movement, that is aimed at, which is known less well; and how much more than other errors it counts to leave or to
move more than that."""
BEATEN = 1.1
"""Designs that leave so many times the rule's error may move the control as much as it does."""
ALIKE = 1.2
"""Rules that leave up to so many times the least error after a load on the learnt process may leave the least on the
plant."""
NEARLY = 1.5
"""A rule that noise forbids is no measure of movement where an allowed one leaves up to so many times its error."""
BEHIND = 0.9
"""Where no design reaches that share: of what is aimed at then the best of them leaves so much, and little is given for
quiet."""
_LEAST, _ROUNDING = 1e-9, 1e-3


@dataclass(frozen=True)
class RunningGains:
    """What runs, and what the loop's control may do.

    Attributes
    ----------
    gains : Fopid
    noise : float
        Standard deviation of the measurement's noise; 0 where it is not known.
    control_movement : float
        Standard deviation of the control, from that noise, that new gains may cause; what the running ones cause is
        allowed in any case.
    control_peak : float
        How far a unit step of the setpoint may take the control, by its limits; infinite for none.
    control_rate : float
        How fast it may move the control, by the limit on its moves [1/s]; infinite for none. What the running ones do
        is allowed in any case.
    control_room : (float, float)
        Limits of the control, from where it rests.
    pace, antiwindup
        Of the controller.
    filter, weights
        Of the measurement and of the setpoint, that run with the gains.
    spectrum : NoiseSpectrum or None
        Of that noise; None where it may be white.
    noise_gain_aim : float
        No more than this is aimed at, since an earlier round of the tuning did not either; infinite where this is the
        first.
    """

    gains: Fopid
    noise: float = 0.0
    control_movement: float = math.inf
    control_peak: float = math.inf
    control_rate: float = math.inf
    filter: MeasurementFilter = NO_FILTER
    weights: SetpointWeights = WHOLE_SETPOINT
    spectrum: NoiseSpectrum | None = None
    noise_gain_aim: float = math.inf
    control_room: tuple[float, float] = UNLIMITED
    pace: Pace = UNPACED
    antiwindup: AntiWindup = "back_calculation"


class LoopJudge:
    """Judges designs beside the gains that run.

    Parameters
    ----------
    process : Process
    sample_time : float
        Of the controller [s].
    running : RunningGains
    ms_max : float
        Running gains beyond it are not to be kept; a rule beyond it is nothing to beat.
    """

    def __init__(self, process: Process, sample_time: float, running: RunningGains, ms_max: float) -> None:
        self.process = _held_by(running, process, sample_time)
        self.sample_time, self.running, self._ms_max = sample_time, running, ms_max
        self._judged: dict[Loop, LoopWorth] = {}
        self._trial: FlawTrial | None = None
        self.crossover, self.noise_excess = 0.0, 0.0
        self.best: tuple[float, RobustTuning, TuningRequest] | None = None
        self.runs = Loop(self.process, running.gains, running.filter, running.weights)
        self._horizon = default_horizon(self.runs) if stability(self.runs).stable else None
        old = noise_gain(self.runs, sample_time, running.spectrum) if self._horizon else 0.0
        self.whiter = noise_gain(self.runs, sample_time) / old if running.spectrum and old else 1.0
        """How much more white noise would move the control of what runs: about so much more it may by a design that
        is made for white noise."""
        allowed = running.control_movement / running.noise if running.noise > 0.0 else math.inf
        self.noise_gain_max, self._quietest = max(allowed, old, _LEAST), max(old, _LEAST)
        self._rules: tuple[LoopWorth, ...] = ()
        self._least_load, self._ahead_in_noise = 0.0, AHEAD_IN_NOISE
        self.control_peak = running.control_peak if math.isfinite(running.control_peak) else None
        self.control_rate = running.control_rate if math.isfinite(running.control_rate) else None

    def see_flaws(self, trial: FlawTrial) -> None:
        """Judge errors after a load by what the loop with its flaws leaves beside what runs, where that is known."""
        self._trial = trial if trial.knows_loads else None

    def horizon(self, loop: Loop) -> float:
        """Over which a loop is looked at [s]: the time in which what runs settles; its own where that does not."""
        return self._horizon or default_horizon(loop)

    def worth(self, loop: Loop) -> LoopWorth:
        """Over the time in which what runs settles; each loop is looked at once."""
        if loop not in self._judged:
            horizon = self.horizon(loop)
            worth = loop_worth(loop, self.sample_time, horizon, self.running.spectrum)
            if math.isinf(worth.load) and math.isfinite(worth.ms):  # unknown so long after the step
                shorter = min(horizon, default_horizon(loop))
                worth = loop_worth(loop, self.sample_time, shorter, self.running.spectrum)
            self._judged[loop] = self._with_flaws(loop, worth)
        return self._judged[loop]

    def _with_flaws(self, loop: Loop, worth: LoopWorth) -> LoopWorth:
        if self._trial is None or loop == self.runs or math.isinf(worth.load):
            return worth
        before = self.worth(self.runs).load
        return replace(worth, load=before * self._trial.load_share(loop)) if math.isfinite(before) else worth

    def note_textbook(self, rule: LoopWorth) -> None:
        """Take a rule as one to beat, if it is within the limit on max |S| and leaves less error than what runs."""
        if rule.ms <= self._ms_max and rule.load < self.worth(self.runs).load:
            self._rules += (rule,)

    @property
    def textbook(self) -> LoopWorth | None:
        """The rule with the least error after a load; None where what runs leaves less than all."""
        return min(self._rules, key=lambda rule: rule.load, default=None)

    def allow_the_noise_of_rules(self, found: Iterable[LoopWorth]) -> bool:
        """Aim at no less movement than theirs where designs that may be used leave clearly more error; whether so."""
        before, least = self.noise_gain_aim, min((one.load for one in found), default=0.0)
        if self.textbook and least > BEATEN * self.textbook.load:
            self._ahead_in_noise = 1.0
        return self.noise_gain_aim > before

    def note_reach(self, found: Iterable[LoopWorth]) -> None:
        """Take designs that may be used for all that can be had: what none of them reaches is no aim."""
        self._least_load = min((one.load for one in found if one.ms <= self._ms_max), default=0.0)

    @property
    def load_aim(self) -> float:
        """A share of the textbook's error after a load; where nothing reaches that, a little more than the least.

        That is no more than the textbook's own where one leaves less. Without a textbook there is no aim (infinite).
        """
        if self.textbook is None:
            return math.inf
        rule, reached = self.textbook.load, self._least_load / BEHIND
        return max(AHEAD * rule, min(reached, rule) if self._least_load <= rule else reached)

    @property
    def noise_gain_aim(self) -> float:
        """What is allowed of the noise gain, and no more than the textbook needs, unless that hardly moves it.

        Of rules that leave about as much, the quietest says that: on the plant itself it may be the best. In a further
        round, where no rule leaves less than what runs, no more than that is moved now.
        """
        before, hardly = min(self.noise_gain_max, self.running.noise_gain_aim), HARDLY_MOVES * self.noise_gain_max
        if self.textbook is None and math.isfinite(self.running.noise_gain_aim):
            return max(min(before, hardly), self._quietest)
        if self.textbook is None or math.isinf(self.noise_gain_max):
            return max(before, self._quietest)
        most = ALIKE * self._to_be_met(self.textbook).load
        quietest = min(rule.noise_gain for rule in self._rules if rule.load <= most)
        return max(min(max(self._ahead_in_noise * quietest, hardly), before), self._quietest)

    def _to_be_met(self, least: LoopWorth) -> LoopWorth:
        """The rule whose movement says what is aimed at: not the least one where that moves more than is allowed.

        Then it is the best of those allowed, if that is nearly as good; in a further round in any case.
        """
        allowed = [rule for rule in self._rules if rule.noise_gain <= self.noise_gain_max]
        best = min(allowed, key=lambda rule: rule.load, default=least)
        is_first = math.isinf(self.running.noise_gain_aim)
        return least if is_first and best.load > NEARLY * least.load else best

    @property
    def load_scale(self) -> float:
        """What the error after a load step of 1 / gain is multiplied by to count as much as now the setpoint's does."""
        old = self.worth(self.runs)
        known = math.isfinite(old.setpoint) and 0.0 < old.load < math.inf
        return abs(process_gain(self.process)) * old.setpoint / old.load if known else 1.0

    def reason(self, tuned: RobustTuning) -> str:
        """Why a design is not better than what runs; empty when it is."""
        new, _ = self._pair(tuned)
        self.crossover = tuned.tuning.achieved.crossover if tuned.tuning and tuned.tuning.achieved else 0.0
        self.noise_excess = new.noise_gain / self.noise_gain_max
        if self.noise_excess > 1.0:
            return self.too_noisy(new)
        if tuned.tuning is not None and (too_fast := self.too_fast(loop_of(self.process, tuned.tuning))):
            return too_fast
        return self.not_better(new)

    @property
    def runs_near_instability(self) -> bool:
        """Whether the gains that run are beyond the limit on max |S|: what takes their place need not beat them."""
        return self.worth(self.runs).ms > self._ms_max

    def not_better(self, new: LoopWorth) -> str:
        """Why what a design is worth is no more than what runs is, its movement in noise included."""
        old = self.worth(self.runs)
        if math.isinf(old.setpoint):
            return "" if math.isfinite(new.setpoint) else "its responses are not known"
        if self.runs_near_instability:  # it is not to be kept, however fast it is
            return ""
        if new.setpoint > WORSE * old.setpoint or new.load > WORSE * old.load or self.errors(new) > BETTER:
            return f"not better than what runs on the learnt process: {new}; now {old}"
        if self.errors(new) * self._more_movement(new, old) ** QUIET_WEIGHT > BETTER:
            return f"not worth its movement beside what runs on the learnt process: {new}; now {old}"
        return ""

    def _more_movement(self, new: LoopWorth, old: LoopWorth) -> float:
        """By how much more noise moves the control, from what can be felt on; 1 where it moves it less."""
        if math.isinf(self.noise_gain_max):
            return 1.0
        return max(new.noise_gain / max(old.noise_gain, LEAST_SHARE * self.noise_gain_max), 1.0)

    def too_fast(self, loop: Loop) -> str:
        """Why the limit on the control's moves forbids a loop; empty when it does not."""
        if self.control_rate is None:
            return ""
        now = self._rate(self.runs) if self._horizon else 0.0
        most, rate = max(self.control_rate, now), self._rate(loop)
        if rate <= most * (1.0 + _ROUNDING):
            return ""
        return f"a unit step of the setpoint would move the control by {rate:.3g} per second ({most:.3g} is allowed)"

    def _rate(self, loop: Loop) -> float:
        """Infinite for a loop whose response is not known."""
        try:
            return control_rate(loop, self.sample_time, self.horizon(loop))
        except InputError:
            return math.inf

    def too_noisy(self, new: LoopWorth) -> str:
        """Why noise forbids a loop; empty when it does not."""
        if new.noise_gain <= self.noise_gain_max:
            return ""
        moves, most = new.noise_gain * self.running.noise, self.noise_gain_max * self.running.noise
        return f"the measurement's noise would move the control by {moves:.3g} ({most:.3g} is allowed)"

    def take(self, tuned: RobustTuning, wanted: TuningRequest) -> None:
        """Keep a design if it is the best so far."""
        score = self.score(self._pair(tuned)[0], tuned.tuning.controller if tuned.tuning else None)
        if self.best is None or score < self.best[0]:
            self.best = score, tuned, wanted

    def score(self, new: LoopWorth, controller: Fopid | None = None) -> float:
        """Errors beside those of the running gains; less control from noise is worth some of it, more load none.

        With a controller, the simpler the better.
        """
        load = new.load / self.load_aim if self.textbook else 0.0
        moves = new.noise_gain / self.noise_gain_aim
        quiet = max(moves, LEAST_SHARE) if load <= 1.0 else 1.0
        return float(
            self.errors(new)
            * PLAIN ** _terms(controller)
            * min(quiet, 1.0) ** QUIET_WEIGHT
            * (max(load, 1.0) * max(moves, 1.0)) ** SHORT_WEIGHT
        )

    def errors(self, new: LoopWorth) -> float:
        """Both indices beside those of the running gains; below 1 is better."""
        old = self.worth(self.runs)
        if math.isinf(old.setpoint):
            return new.load
        return float((new.load / old.load) ** LOAD_WEIGHT * (new.setpoint / old.setpoint) ** (1.0 - LOAD_WEIGHT))

    def told(self, tuned: RobustTuning, name: str, why: str = "") -> str:
        """What the new gains are worth beside the old ones, and why it is these."""
        new, old = self._pair(tuned)
        near = f", too near to instability to be kept ({self._ms_max:g} is allowed)" * self.runs_near_instability
        return f"{name} was best{f' ({why})' if why else ''}: {new}; before {old}{near}"

    def _pair(self, tuned: RobustTuning) -> tuple[LoopWorth, LoopWorth]:
        if tuned.tuning is None or tuned.tuning.controller is None:
            raise InputError("a tuning without gains; allowed: one that succeeded")
        return self.worth(loop_of(self.process, tuned.tuning)), self.worth(self.runs)


def _terms(controller: Fopid | None) -> int:
    """How many more things than a PI a controller has: a derivative, orders that are not whole."""
    if controller is None:
        return 0
    whole = controller.lam == 1.0 and (controller.mu == 1.0 or not controller.kd)
    return (controller.kd != 0.0) + (not whole)


def _held_by(running: RunningGains, process: Process, sample_time: float) -> Process:
    """The process; behind the hold of the control where what runs holds it so only.

    The derivative of a lag whose order was learnt to be a little below 1 rises without end, far beyond the ticks.
    """
    held = behind_hold((process,), sample_time)[0]
    alone, behind = (stability(Loop(each, running.gains, running.filter)).stable for each in (process, held))
    return held if behind and not alone else process


def loop_of(process: Process, tuning: TuningResult) -> Loop:
    """The loop of a design, which has gains."""
    if tuning.controller is None:
        raise InputError("a tuning without gains; allowed: one that succeeded")
    return Loop(process, tuning.controller, tuning.filter, tuning.weights)
