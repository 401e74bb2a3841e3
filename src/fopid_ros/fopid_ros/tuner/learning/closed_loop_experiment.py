"""An experiment on the running loop: wait until it rests, find how far to move it, move it."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from fopid_core.design.identification.noise import reported_step
from fopid_core.errors import InputError
from fopid_core.runtime.excitation import Excitation, ExcitationSettings, Kind
from fopid_ros.tuner.learning.announcement import DUE, LEFT, LONGEST, ExperimentLength
from fopid_ros.tuner.learning.calm import Calm
from fopid_ros.tuner.learning.guarded_excitation import GuardedExcitation
from fopid_ros.tuner.learning.loop_baseline import LoopBaseline
from fopid_ros.tuner.learning.loop_tap import LoopTap, Tick
from fopid_ros.tuner.learning.loop_wait import LoopWait, Stage
from fopid_ros.tuner.learning.reach import NOT_MOVED, Reach
from fopid_ros.tuner.learning.rest import RestingLoop, RestlessError, usual_rest
from fopid_ros.tuner.learning.running_controller import INTEGRAL_TIMES, TICKS_MIN, integral_time
from fopid_ros.tuner.learning.sensor_faults import LoneSample

PRBS_ORDER = 5
EXCITATIONS = {"prbs": (1 << PRBS_ORDER) - 1, "relay": 8, "step": 2}
"""Kinds of experiment, and into how many holds each divides its duration."""
REST_SHARE = 0.08
"""Share of that length over which rest is judged."""
PROBE_SHARE, PROBE_SHARE_UNTIL_KNOWN, PROBES = 1.0 / 12.0, 1.0 / 24.0, 8
"""Share of that length that a probe is held at most, also of an experiment that ends when enough is known, and how many
there are at most."""
LEAST_TICKS = 2
"""So many ticks of the controller is a move held at least."""
QUICK, LATE, MIRRORED, LONGER, PROBE_SHARE_MOST = 1, 1.2, 2.0, 2.0, 1.0 / 6.0
"""After so many probes without an answer, or one whose answer was not seen after so many holds, or became so many times
as large as the way back makes that of a loop that swings, the next is held so much longer, at most that share of the
length: the answer may come behind a delay, or go the other way at first."""
FIRST_NOISES, FIRST_RANGE, FIRST_SHARE = 3.0, 0.002, 0.1
"""The first probe: what holds a deviation of so many noises, that share of the control's range, or what holds that
share of the allowed deviation, whichever is least."""
MOST_LARGER = 4.0
"""How much larger a probe is than the one before at most."""
RANGE_SHARE, ROOM_SHARE = 0.1, 0.8
"""No move is larger than these shares of the control's range, and of what is left to its limits."""
WANTED_NOISES, WANTED_SHARE = 15.0, 0.35
"""How far a probe is meant to move the measurement: so many noises, at most that share of the allowed deviation."""
SEEN_SWINGS = 2.0
"""A move of so many times what the measurement does at rest is an answer."""
SEEN_SHARE = 0.9 * WANTED_SHARE
"""So is one of this share of the allowed deviation, nearly all that a probe is meant to make."""
MOST_SHARE, MOST_LARGER_AGAIN = 0.6, 3.0
"""Share that an experiment aims at that is made because the one before said too little, and how much larger it is."""
GENTLER, AGAIN, BARELY = 0.5, 2, 1.2
"""An experiment that leaves a band that nobody has asked for, but by less than a fifth, is made anew once it has died
out or had the time to, with so much of its move and so often at most."""
SETTLED_SHARE = 0.05
"""Share of the largest deviation made that counts as rest."""
SETTLE_SHARE, CALM_SHARE = 0.3, 0.05
"""How long the experiment may take to die out, and how long calm is asked for, in lengths of the experiment."""
SMOOTHED_SHARE = 0.2
"""Share of that calm over which noise is averaged out: of a hundred samples one is often beyond three deviations."""
SEEN_SAMPLES = 2000
"""So many of the newest samples show how a measurement is quantised."""
TICKS_REMEMBERED = 20_000
"""So many ticks at rest at most are looked through for samples that are far off, which come seldom."""
LOOKS_AT = (2, 3, 4, 5, 6, 8, 10, 13, 17, 22)
"""After how many holds of a prbs it is looked whether enough is known."""
WAY_BACK = (0.5, 0.6, 0.7, 0.8, 0.9)
"""Where a probe is on its way back and may be over before its time, since the measurement is back where it was."""
FORESIGHT = 0.25
"""How far ahead the first probe is judged, as a share of its hold."""


@dataclass(frozen=True)
class ExperimentSettings:
    """What is asked of it; zeros are chosen from the running loop.

    Attributes
    ----------
    excitation : str
        ``prbs``, ``relay`` or ``step``.
    amplitude : float
        How far the control is moved.
    deviation_max : float
        Distance of the measurement from the setpoint that ends it.
    duration : float
        [s]
    until_known : bool
        Whether a ``prbs`` whose duration nobody has said ends before its time once enough is known.
    proved : bool
        Whether gains are tried out after it, watched and proved: that takes its time as well.
    """

    excitation: Kind = "prbs"
    amplitude: float = 0.0
    deviation_max: float = 0.0
    duration: float = 0.0
    until_known: bool = True
    proved: bool = False


class ClosedLoopExperiment:
    """Moves the loop within bounds, through what is added to its control.

    Parameters
    ----------
    tap : LoopTap
    wait : LoopWait
    loop : LoopBaseline
        What the controller says of itself; the rest is filled in by ``measure``.
    wanted : ExperimentSettings
    before : Reach
        Of what the running gains were learnt by: it moves the measurement as far.

    Attributes
    ----------
    duration : float
        How long one experiment takes [s].
    content : float
        How many times what is wanted of a look at its record is enough.
    learnt_since : float
        From when on is learnt [s]: from its beginning, or from that of the rest before, where the loop was on its way.
    latest : float
        No further experiment is begun that would end later, by the loop's time [s].
    escaped : str
        How the last move took the measurement, or the control, to its bounds; empty where it did not.
    """

    def __init__(
        self, tap: LoopTap, wait: LoopWait, loop: LoopBaseline, wanted: ExperimentSettings, before: Reach = NOT_MOVED
    ) -> None:
        self.loop = loop
        self.loop.deviation_least, self.loop.deviation_most = before.allowed, before.most
        self._tap, self._wait, self._wanted, self._before = tap, wait, wanted, before
        self._amplitude = self._peak = self._foresight = 0.0
        self.latest, self.learnt_since, self.content = math.inf, math.nan, 1.0
        self._began, self._said, self._due = math.nan, math.inf, math.inf
        self._first, self._widened, self.escaped = True, False, ""
        self.duration = self._chosen_duration()

    @property
    def reach(self) -> Reach:
        """How far the measurement has been moved here or before, for another that follows."""
        before, allowed = self._before, max(self.loop.deviation_max, self._before.allowed)
        if self._peak < before.moved:
            return replace(before, allowed=allowed, most=allowed, duration=self.duration)
        return Reach(self._peak, allowed, self._amplitude, allowed, self.duration)

    def _chosen_duration(self) -> float:
        """Of the experiment [s]."""
        gains = self.loop.controller.gains
        duration = self._wanted.duration or INTEGRAL_TIMES * integral_time(gains)
        duration = duration if math.isfinite(duration) else self._before.duration
        if not (duration or gains.kp or gains.ki or gains.kd):
            first = "record a step of the control in manual mode: fopid design FILE gives the first ones"
            raise InputError(f"kp, ki and kd are 0, which shows no time scale: {first}; or give a duration above 0 s")
        return max(duration, 10 * TICKS_MIN * self.loop.controller.sample_time)

    @property
    def rest_window(self) -> float:
        """Over which rest is judged [s]."""
        return max(TICKS_MIN * self.loop.controller.sample_time, REST_SHARE * self.duration)

    @property
    def plan(self) -> list[str]:
        """What ``excite`` will do, in words."""
        wanted, controller = self._wanted, self.loop.controller
        moved = "by as much as is seen above the noise, found by small steps first"
        if math.isfinite(controller.control_range):
            moved += f", at most {RANGE_SHARE * controller.control_range:.3g}"
        if wanted.amplitude:
            moved = f"by {wanted.amplitude:.3g}"
        ends = f"{wanted.deviation_max:.3g}" if wanted.deviation_max else "the band found while measuring"
        return [
            f"exciting: {wanted.excitation} for {self.duration:.3g} s; the control is moved {moved}; ends at once when "
            f"the measurement is further from the setpoint than {ends}"
        ]

    def measure(self, borne: float = math.inf, announced: bool = True) -> None:
        """The loop as it is, once it rests: where, and how noisy it is.

        Parameters
        ----------
        borne : float
            How far from the setpoint the measurement may be meanwhile, with gains that are not known to hold the loop.
        announced : bool
            Whether it is told how long all of it takes, or only what is waited for.

        Raises
        ------
        RestlessError
            If it does not come to rest, or goes further.
        InputError
            If an amplitude that was asked for leaves its limits.
        """
        loop, history, asked = self.loop, self._tap.history, self._wanted.deviation_max
        length = self.length
        resting = RestingLoop(loop, history, self.rest_window, self.duration, asked)
        self._tap.set_tick_hook(resting.hear)
        left, told = (length.in_all, str(length)) if announced else (0.0, "until the loop rests")
        self._wait.until(
            lambda: resting.is_over(borne), lambda: Stage("measuring", 0.0, left, loop.offset, message=told)
        )
        self.latest = min(self.latest, resting.began + LONGEST * self.duration)
        self._began, self._said = resting.began, length.experiment
        self._due = max(resting.began + DUE * self._said, resting.newest + LEFT * length.due)
        if not loop.at_steady_state:
            raise RestlessError(loop.why_not_at_rest(self.duration))
        loop.listen(history.unmoved(TICKS_REMEMBERED), asked, history.travel("setpoint"))
        loop.check_amplitude(self._wanted.amplitude)
        self.learnt_since = resting.since if loop.on_its_way else resting.newest

    @property
    def length(self) -> ExperimentLength:
        """How long all of it usually takes."""
        rest = usual_rest(self.loop, self._tap.history, self.rest_window)
        return ExperimentLength(self.duration, rest, self.ends_when_known, self._wanted.proved)

    @property
    def ends_when_known(self) -> bool:
        """Whether it may end before its time, since nobody has said that."""
        wanted = self._wanted
        return wanted.until_known and wanted.excitation == "prbs" and not wanted.duration

    @property
    def newest(self) -> float:
        """When the loop was heard last [s]."""
        return self._tap.history.newest_time("control")

    @property
    def fits(self) -> bool:
        """Whether there is time for one more experiment within what was announced."""
        return self.newest + self.duration <= self.latest

    def excite(self, known: Callable[[], bool] = lambda: False) -> str:
        """Make the experiment; after one that said too little the whole of it, with larger moves if that moved little.

        Parameters
        ----------
        known : callable
            Whether enough is known; asked now and then where a first experiment is to end then. May take its time.

        Returns
        -------
        str
            Why it was stopped; empty when it came to its end.
        """
        until = known if self.ends_when_known and self._first else None
        self._first = False
        if self._wanted.amplitude:
            self._amplitude = self._wanted.amplitude
        elif not self._amplitude:
            ended = self._probe()
            if ended:
                return ended
        else:
            larger = MOST_SHARE * self.loop.deviation_max / max(self._peak, 1e-300)
            self._amplitude = min(self._amplitude * min(max(larger, 1.0), MOST_LARGER_AGAIN), self._most())
        excitation = self._made_whole(until)
        for _ in range(0 if self._wanted.deviation_max or self._wanted.amplitude else AGAIN):
            if not excitation.outside or self.settle("exciting", 0.1) > self.furthest:
                break
            self._amplitude *= GENTLER
            self._begin_anew()
            excitation = self._made_whole(until)
        return "" if excitation.completed else excitation.reason

    @property
    def furthest(self) -> float:
        """The deviation that is borne: a fifth more than a band that nobody has asked for, which is a guess."""
        return (1.0 if self._wanted.deviation_max else BARELY) * self.loop.deviation_max

    def widen(self) -> bool:
        """Allow more, once, after one that told nothing, where nobody has said how far it may go; whether it may."""
        if not self.may_widen:
            return False
        self._widened = self._first = True  # what it shows is looked at anew
        self._begin_anew()
        self.loop.allow_a_bump()
        return True

    @property
    def may_widen(self) -> bool:
        """Whether nobody has said how far it may go, people go further, and it has not been widened."""
        asked = self._wanted.deviation_max or self._wanted.amplitude or self._before.moved
        return not (self._widened or asked) and self.loop.bump > self.loop.deviation_max

    def widen_after_escape(self) -> bool:
        """After one that ended outside a band that nobody asked for: allow more, as ``widen`` does.

        Returns
        -------
        bool
            Whether it may go further, there is time, and the loop does not go further than that by itself.
        """
        if not (self.escaped and self.may_widen and self.fits):
            return False
        return self.settle("exciting", 0.1, self.loop.bump) <= self.loop.bump and self.widen()

    def comes_back(self) -> bool:
        """Wait whether a loop that was taken to its bounds comes back from there, without going much further out."""
        borne = BARELY * self.loop.deviation_max
        return self.settle("exciting", 0.6, borne) <= borne

    def _begin_anew(self) -> None:
        """What is said of an experiment holds for the next as well."""
        length = self.length
        self._began, self._said, self._due = self.newest, length.experiment, self.newest + length.due

    def _made_whole(self, known: Callable[[], bool] | None) -> Excitation:
        """The excitation itself, with the amplitude that was found; until enough is known, where that is asked."""
        excitation = Excitation(self._settings(self._wanted.excitation, self._amplitude, self.duration))
        looks = [look / EXCITATIONS["prbs"] for look in LOOKS_AT]
        due = (self._due - self.newest) / self.duration
        looks = sorted([*looks, due]) if looks[0] < due < 1.0 else looks
        self._run_excitation(
            excitation, lambda: 0.1 + 0.5 * excitation.progress,
            known=lambda _: known is not None and self._is_known(known), looks=looks if known else (),
        )  # fmt: skip
        self._note_resolution()
        return excitation

    def _is_known(self, known: Callable[[], bool]) -> bool:
        """Whether enough is known: with less, where it takes longer than was said, and with any process when due.

        Where none shows then, what was said is past: enough is what it was before.
        """
        if self.newest >= self._due:
            self.content, self._due, self._said = math.inf, math.inf, math.inf
        else:
            self.content = max((self.newest - self._began) / self._said, 1.0) ** 2
        return known()

    def settle(self, phase: str, progress: float, borne: float = math.inf) -> float:
        """Wait until the experiment has died out, not longer than that should take; the largest deviation meanwhile.

        It ends at once where that is more than is borne.
        """
        limit, calm_for = SETTLE_SHARE * self.duration, CALM_SHARE * self.duration
        calm = Calm(self.residual_transient(), SMOOTHED_SHARE * calm_for)
        sensor = LoneSample.within(self.loop.deviation_max)
        setpoint = self.loop.setpoint
        newest = Tick(-math.inf, setpoint, setpoint, 0.0)  # until one is heard
        began: list[float] = []
        furthest = 0.0

        def hook(tick: Tick) -> None:
            nonlocal newest, furthest
            newest = replace(tick, measurement=sensor.seen(tick.measurement))
            began.append(tick.time) if not began else None
            furthest = max(furthest, abs(newest.measurement - setpoint))
            calm.step(tick.time, newest.measurement - setpoint)

        self._tap.set_tick_hook(hook)
        self._wait.until(
            lambda: bool(began) and (calm.lasted >= calm_for or newest.time - began[0] >= limit or furthest > borne),
            lambda: Stage(phase, progress, deviation=newest.measurement - setpoint, message="letting it settle"),
        )
        return furthest

    def _most(self) -> float:
        """The largest move of the control that is ever made."""
        return min(RANGE_SHARE * self.loop.controller.control_range, ROOM_SHARE * self.loop.room)

    def _settings(self, kind: Kind, amplitude: float, duration: float) -> ExcitationSettings:
        loop = self.loop
        hold = max(duration / EXCITATIONS[kind], LEAST_TICKS * loop.controller.sample_time)
        upwards = loop.controller.gains.kp or loop.controller.gains.ki or 1.0
        return ExcitationSettings(
            kind=kind, amplitude=math.copysign(amplitude, upwards), acts_on="control",
            low=loop.setpoint - loop.deviation_max, high=loop.setpoint + loop.deviation_max,
            hold=hold, order=PRBS_ORDER, hysteresis=3.0 * loop.unrest,
        )  # fmt: skip

    def _probe(self) -> str:
        """Find the amplitude that moves the measurement well beyond its noise, from below."""
        loop = self.loop
        amplitude = self._first_amplitude()
        seen = max(min(SEEN_SWINGS * loop.swing, SEEN_SHARE * loop.deviation_max), loop.least_move)
        looks, share = (WAY_BACK, PROBE_SHARE_UNTIL_KNOWN) if self.ends_when_known else ((), PROBE_SHARE)
        waits = False

        def is_back(guarded: GuardedExcitation) -> bool:
            return abs(guarded.level) <= seen

        for probe in range(PROBES):
            wanted = max(WANTED_NOISES * loop.least_move, 2.0 * seen, self._before.moved)
            wanted = min(WANTED_SHARE * loop.deviation_max, wanted)
            if waits:  # the longest moves of a prbs are no longer than such a probe
                wanted *= MOST_SHARE / WANTED_SHARE
            excitation = Excitation(self._settings("step", amplitude, 2.0 * share * self.duration))
            guarded = self._run_excitation(excitation, lambda: 0.05, wanted, is_back, looks)
            if not excitation.completed:
                return excitation.reason
            self._note_resolution()
            answered = self._peak > seen
            in_time = guarded.peak_until(LATE * excitation.settings.hold)
            early = in_time > max(seen, self._peak / MIRRORED) or share >= PROBE_SHARE_MOST
            larger = wanted / max(self._peak, 1e-300) if answered else math.inf
            if answered and early and (larger <= MOST_LARGER or amplitude == self._most()):
                self._amplitude = min(amplitude * min(larger, MOST_LARGER), self._most())
                return ""
            if amplitude == self._most() and share >= PROBE_SHARE_MOST:
                break
            late = answered and not early
            waits = waits or late
            amplitude = min(amplitude * (1.0 if late else MOST_LARGER), self._most())
            if late or not (answered or probe < QUICK):
                share = min(LONGER * share, PROBE_SHARE_MOST)
        moved = f"the measurement moved by no more than {self._peak:.3g} ({loop.by_itself})"
        most = "the most that is made where nobody says an amplitude"
        return f"{moved} when the control was moved by {amplitude:.3g}, {most}: is the loop closed?"

    def _first_amplitude(self) -> float:
        loop, kp = self.loop, abs(self.loop.controller.gains.kp)
        limited = math.isfinite(loop.controller.control_range)
        if not (kp or limited):
            raise InputError("amplitude = 0; allowed: above 0, since kp = 0 and no limits of the control give a scale")
        sizes = [FIRST_SHARE * loop.deviation_max * kp, FIRST_NOISES * loop.least_move * kp]
        sizes.append(FIRST_RANGE * loop.controller.control_range if limited else math.inf)
        if not self._most() > 0.0:
            at = f"the control rests at {loop.control:.4g}, at a limit"
            raise InputError(f"{at}; allowed: a control with room to both sides of it")
        least = min(size for size in (*sizes, math.inf) if size > 0.0)
        return min(max(least, loop.control_spread), self._most())

    def _note_resolution(self) -> None:
        """A quantised measurement that stood still at rest shows its steps when it moves."""
        self.loop.noise = max(self.loop.noise, self._quantisation())
        self.loop.unrest = max(self.loop.unrest, self.loop.noise)

    def _quantisation(self) -> float:
        """Standard deviation that the steps of the measurement make, as far as it has moved."""
        return reported_step(self._tap.history.newest_values("measurement", SEEN_SAMPLES)) / math.sqrt(12.0)

    def _run_excitation(
        self, excitation: Excitation, progress: Callable[[], float], enough: float = math.inf,
        known: Callable[[GuardedExcitation], bool] = lambda _: False, looks: Sequence[float] = (),
    ) -> GuardedExcitation:  # fmt: skip
        """Run an experiment tick by tick, at the pace of the controller; at these shares of it, see what is known."""
        loop, history, ended, last = self.loop, self._tap.history, threading.Event(), [0.0]
        regained = history.regained
        guarded = GuardedExcitation(excitation, loop, self._foresight or FORESIGHT * excitation.settings.hold, enough)

        def hook(tick: Tick) -> None:
            if ended.is_set():
                return
            guarded.end("" if history.regained == regained else "the controller was given other gains meanwhile")
            added = guarded.step(tick)
            if added != last[0] or guarded.finished:
                self._tap.inject(added)
                last[0] = added
            if guarded.finished:
                ended.set()

        self._tap.set_tick_hook(hook)
        asked, whole = excitation.settings, excitation.settings.duration
        lasts = f"{'up to ' * bool(looks)}{whole:.3g} s, within {loop.deviation_max:.3g} of the setpoint"
        told = f"{asked.kind} of {asked.amplitude:.3g} for {lasts}"

        def run_until(share: float) -> bool:
            """Whether it is over when so much of it has been made."""
            self._wait.until(lambda: ended.is_set() or excitation.progress >= share, lambda: Stage(
                "exciting", progress(), (1.0 - excitation.progress) * whole,
                history.newest("measurement") - loop.setpoint,
                message=told,
            ))  # fmt: skip
            return ended.is_set()

        for share in _not_overtaken(excitation, looks):
            if run_until(share):
                break
            if known(guarded):  # meanwhile it goes on
                guarded.complete("enough is known")
                break
        run_until(math.inf)
        self._peak = guarded.peak
        self.escaped = excitation.reason if excitation.outside or guarded.cornered else ""
        if guarded.answer_time > 0.0:
            self._foresight = guarded.answer_time
        return guarded

    @property
    def made(self) -> str:
        """How large the last experiment was, in the words of what can be asked for."""
        band = f"the measurement by {self._peak:.3g} of the {self.loop.deviation_max:.3g} that deviation_max allows"
        return f"amplitude moved the control by {self._amplitude:.3g}, {band}"

    def residual_transient(self) -> float:
        """What may still be left of the experiment when the new gains come."""
        return max(3.0 * self.loop.unrest, SETTLED_SHARE * self._peak)


def _not_overtaken(excitation: Excitation, looks: Sequence[float]) -> Iterator[float]:
    """When it is looked, but for where the look before has taken so long that the next is due as well."""
    for share, following in pairwise((*looks, math.inf)):
        if excitation.progress < following:
            yield share
