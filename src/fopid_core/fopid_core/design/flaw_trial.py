"""Gains tried behind an actuator that sticks, has play or is slow, or against dry friction: nothing linear shows that.

An actuator that is slow shows it in large moves: there it lags behind by up to a right angle, whatever margins the loop
has, and a loop that is fast for it swings from limit to limit for ever. It does not where the controller moves its
control no faster than that, since what it remembers is what the actuator does then, and the setpoint so slowly that
the actuator can follow.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from fopid_core.design.identification.flaws import Flaws, Stem
from fopid_core.design.identification.friction import Body
from fopid_core.design.loop_worth import control_rate_in_noise
from fopid_core.model.evaluation import default_horizon
from fopid_core.model.loop import Loop
from fopid_core.model.margins import margins
from fopid_core.model.process import Process
from fopid_core.model.stability import stability
from fopid_core.runtime.controller import FopidController
from fopid_core.runtime.convolved_plant import plant_of
from fopid_core.runtime.plant import PlantSettings
from fopid_core.runtime.settings import UNPACED, AntiWindup, Pace, as_designed

UNLIMITED = (-math.inf, math.inf)
LOADS = (2.0, 20.0)
"""Steps of the load that are tried, in dead bands or frictions: one that is nearly swallowed, one that hardly is."""
MOVE_SHARE = 0.1
"""With a slow actuator steps are tried that take this share of the control's range."""
WORSE = 1.05
"""By how much more error than what runs new gains may leave."""
KICK_SHARE = 0.5
"""That of the setpoint is not answered with more than this share of it, at the crossover of what runs."""
SLOWER_YET = 0.85
"""An actuator may be so much slower than it was learnt to be: gains must be borne by that one as well."""
MORE_GAIN, MOST_LEFT = 2.0, 2.0
"""A process may answer large moves so many times as strongly. At a pace, which takes phase of its own, gains must not
swing then either, which leaves many times the error of what runs."""
CLEAR_OF_NOISE = 3.0
"""A pace below so many standard deviations of the control's moves in mere noise holds the derivative back at rest: then
the loop is another one than was verified."""
RAMPS = (1.0, 0.8, 0.6, 0.4, 0.25, 0.15, 0.08)
SLOW_RAMPS = (0.05, 0.03, 0.02)
"""Of what a slow actuator can follow: shares that the setpoint's ramp is tried with; and where none of them will do,
as where a process turns only as far as its actuator has been away for long (a ship, by its rudder)."""
LARGER_LOADS = (2.0, 3.0)
"""So many times that load must be borne where the setpoint alone is held back: a load may set a loop swinging for ever
that no step of the setpoint does any more."""
GAINED = 0.75
"""A ramp that nothing demands is worth it where it leaves no more than this share of the error without it."""
MOST_TICKS, TICKS_WITHOUT_REST = 5_000, 20_000
"""A tick costs 25 us, and a search tries some five hundred times: of a slow loop the last of the tail is not seen.
Where what runs never comes to rest, others are given longer to show that they run away as well."""
_SEED = 1


@dataclass(frozen=True)
class _Move:
    """A step of the setpoint or of the load, with an actuator that moves so far in a second, and so much more gain."""

    setpoint: float
    load: float
    rate: float
    told: str
    gain: float = 1.0


class FlawTrial:
    """The loop with its flaws after steps of a load and of the setpoint, with the gains that run and with others.

    Parameters
    ----------
    process : Process
        Behind the actuator; where there is friction, the body that it holds stands for it.
    flaws : Flaws
        A dead band, dry friction, or a limit on the actuator's moves.
    sample_time : float
        Of the controller [s].
    noise : float
        Standard deviation of the measurement's noise.
    running : Loop
        What runs.
    room : (float, float)
        Limits of the control, from where it rests. Without both a slow actuator is not tried: nothing says how large
        moves may be.
    pace : Pace
        Of the controller, with what runs; others are held to no more.
    antiwindup : str
        That of the controller.
    large_only : bool
        Whether steps as small as a dead band or friction are left out.
    to_be_kept : bool
        Whether what runs may go on running. What is too near to instability where nothing sticks leaves little of a
        small load, and swings after every larger move: what takes its place may leave twice that.

    Examples
    --------
    >>> from fopid_core.model.fopid import Fopid
    >>> process, play = Process.parse("1/(s+1)"), Flaws(dead_band=0.1, slip=0.0)
    >>> trial = FlawTrial(process, play, 0.1, 0.0, Loop(process, Fopid(kp=1.0, ki=1.0)))
    >>> trial.refusal(Loop(process, Fopid(kp=2.0, ki=2.0)))
    ''
    >>> trial.refusal(Loop(process, Fopid(kp=0.5, ki=0.5)))
    'the actuator has play within 0.1: after a load of 2 times that 2 times the error of what runs is left'
    >>> process, slow = Process.parse("1/((7s+1)(0.3s+1))"), Flaws(rate=7.0)
    >>> trial = FlawTrial(process, slow, 0.1, 0.0, Loop(process, Fopid(kp=4.0, ki=0.6)), (-50.0, 50.0))
    >>> lively = Loop(process, Fopid(kp=12.0, ki=8.0, kd=1.0))
    >>> trial.refusal(lively)
    'the actuator may be as slow as 7 a second: after a setpoint step of 9.2 10 times the error of what runs is left'
    >>> pace = trial.pace(lively)
    >>> round(pace.control, 2), round(pace.setpoint, 2)
    (7.0, 0.96)
    >>> trial.refusal(lively, pace)
    ''
    """

    def __init__(
        self, process: Process, flaws: Flaws, sample_time: float, noise: float, running: Loop,
        room: tuple[float, float] = UNLIMITED, pace: Pace = UNPACED, antiwindup: AntiWindup = "back_calculation",
        large_only: bool = False, to_be_kept: bool = True,
    ) -> None:  # fmt: skip
        self._most_left = WORSE if to_be_kept else MOST_LEFT
        self._process, self._flaws, self._sample_time, self._room = process, flaws, sample_time, room
        self._ticks, self._pace, self._antiwindup = _ticks_until_rest(running, sample_time), pace, antiwindup
        self._level = noise
        self._noise = noise * np.random.default_rng(_SEED).standard_normal(self._ticks)
        self._errors: dict[tuple[Loop, _Move, Pace], float] = {}
        self._steps = self._large_steps(running)
        self._loads = [] if large_only else self._small_loads()
        moves = self._loads + [move for step in self._steps for move in step]
        self._before = {move: self._error(running, move, UNPACED) for move in moves}
        self._running = running

    def refusal(self, loop: Loop, pace: Pace = UNPACED) -> str:
        """Why gains may not be used at this pace; empty where they leave hardly more error than what runs."""
        if self._is_paced(pace) and loop.controller.kd and math.isfinite(pace.control):
            moves = self._level * control_rate_in_noise(loop, self._sample_time)
            if CLEAR_OF_NOISE * moves > pace.control:
                held = f"a control that noise alone moves by {moves:.3g} a second would be held to {pace.control:.3g}"
                return f"{self._flaws}: {held}"
        for move, before in self._borne_at(pace):
            error = self._error(loop, move, pace)
            if math.isinf(error):
                return f"{self._flaws}: after {move.told} the loop runs away"
            if error > self._allowed(move) * before:
                return f"{self._flaws}: after {move.told} {error / before:.2g} times the error of what runs is left"
        return ""

    def load_share(self, loop: Loop) -> float:
        """Error after a load that is large beside a dead band or friction, in noise, beside that of what runs.

        That is a tenth of the control's range, or 20 times them if that is more.
        """
        wide = self._room[1] - self._room[0]
        load = self._loads[-1]
        large = replace(load, load=max(load.load, MOVE_SHARE * wide)) if math.isfinite(wide) else load
        return self._error(loop, large, self._pace) / self._error(self._running, large, UNPACED)

    @property
    def knows_loads(self) -> bool:
        """Whether there is a dead band or friction to judge loads by."""
        return bool(self._loads)

    def _is_paced(self, pace: Pace) -> bool:
        """Whether that holds the controller to more than it is held to now."""
        return pace & self._pace != self._pace

    def _borne_at(self, pace: Pace) -> Iterator[tuple[_Move, float]]:
        """What gains must bear at a pace, with the error of what runs."""
        for move, before in self._before.items():
            if move.gain == 1.0 or self._is_paced(pace):
                yield move, before
        if self._is_paced(pace) and pace.control >= self._pace.control:
            loads = [load for _, load in self._steps if load.gain == 1.0]
            for load, times in product(loads, LARGER_LOADS):
                larger = replace(load, load=times * load.load, told=f"a load of {times * load.load:.2g}")
                yield larger, self._error(self._running, larger, UNPACED)

    def pace(self, loop: Loop) -> Pace:
        """The limits on its moves that a controller is best run with where the actuator is slow; none where it is not.

        That is a ramp of the setpoint alone where gains may be used with that, but not at the actuator's pace.
        """
        if not self._steps:
            return UNPACED
        steps, loads = zip(*self._steps, strict=True)
        control = min((load.rate for load in loads), key=lambda rate: self._left(loop, Pace(rate), loads))
        both = self._best_ramp(control, lambda pace: self._left(loop, pace, steps))
        if not self.refusal(loop, both):
            return both
        ramp = self.ramp(loop)
        return both if self.refusal(loop, ramp) else ramp

    def ramp(self, loop: Loop) -> Pace:
        """How fast the setpoint is best moved where the actuator is slow; no limit where that gains little."""
        if not self._steps:
            return UNPACED
        steps = [step for step, _ in self._steps if step.gain == 1.0]
        best = self._best_ramp(math.inf, lambda pace: self._beside_now(loop, pace, steps) / WORSE)
        without = self._beside_now(loop, UNPACED, steps)
        return best if self._beside_now(loop, best, steps) < GAINED * without else UNPACED

    def _best_ramp(self, control: float, left: Callable[[Pace], float]) -> Pace:
        """That pace of the control, with the ramp of the setpoint that leaves least; 1 is what may be left."""
        follows = self._steps[0][0].setpoint * self._flaws.rate / (MOVE_SHARE * (self._room[1] - self._room[0]))
        usual, slow = ([Pace(control, share * follows) for share in shares] for shares in (RAMPS, SLOW_RAMPS))
        best = min(usual, key=left)
        return best if left(best) <= 1.0 else min((best, *slow), key=left)

    def _beside_now(self, loop: Loop, pace: Pace, moves: Sequence[_Move]) -> float:
        """The largest error after moves, beside that of what runs."""
        return max(self._error(loop, move, pace) / self._before[move] for move in moves)

    def _left(self, loop: Loop, pace: Pace, moves: Sequence[_Move]) -> float:
        """Error after moves, beside what may be left, where it is largest."""
        return max(self._error(loop, move, pace) / (self._allowed(move) * self._before[move]) for move in moves)

    def _small_loads(self) -> list[_Move]:
        friction = self._flaws.friction
        size = friction.size if friction else float(self._flaws.dead_band)
        rate = self._flaws.rate
        return [_Move(0.0, times * size, rate, f"a load of {times:g} times that") for times in LOADS if size]

    def _large_steps(self, running: Loop) -> list[tuple[_Move, _Move]]:
        """Of the setpoint, and of the load, for each of the rates that the actuator may have."""
        wide = self._room[1] - self._room[0]
        if not (math.isfinite(self._flaws.rate) and math.isfinite(wide)):
            return []
        load, crossover = MOVE_SHARE * wide, margins(running).crossover
        setpoint = load * abs(complex(self._process(2.0j * math.pi / (self._ticks * self._sample_time))))
        if math.isfinite(crossover) and (answer := abs(complex(running.controller(1j * crossover)))):
            setpoint = min(setpoint, KICK_SHARE * wide / answer)
        return [
            (
                _Move(setpoint, 0.0, share * self._flaws.rate, f"a setpoint step of {setpoint:.2g}{more}", gain),
                _Move(0.0, load, share * self._flaws.rate, f"a load of {load:.2g}{more}", gain),
            )
            for share, gain, more in (
                (1.0, 1.0, ""), (SLOWER_YET, 1.0, ""), (1.0, MORE_GAIN, f" with {MORE_GAIN:g} times the gain"),
            )
        ]  # fmt: skip

    def _error(self, loop: Loop, move: _Move, pace: Pace) -> float:
        """Sum of the absolute error after a move, at no more than this pace; each is simulated once."""
        asked = loop, move, pace & self._pace
        if asked not in self._errors:
            self._errors[asked] = self._simulated(*asked)
        return self._errors[asked]

    def _simulated(self, loop: Loop, move: _Move, pace: Pace) -> float:
        """The same; infinite where it grows beyond numbers."""
        low, high = self._room
        settings = as_designed(loop.controller, self._sample_time, loop.filter, loop.weights, pace)
        limited = replace(settings, control_min=low, control_max=high, antiwindup=self._antiwindup)
        controller = FopidController(limited)
        friction, most = self._flaws.friction, move.rate * self._sample_time
        plant = (
            Body(friction, self._sample_time) if friction
            else plant_of(PlantSettings(self._process, self._sample_time, delay_model="exact"))
        )  # fmt: skip
        at, stem, total = 0.0, Stem(self._flaws), 0.0
        for noise in self._noise.tolist():
            control = controller.step(move.setpoint, plant.measurement + noise)
            at += min(max(control - at, -most), most)
            plant.step(move.gain * stem.step(at), move.gain * move.load)
            total += abs(move.setpoint - plant.measurement)
            if not total < 1e90:
                return math.inf
        return total

    def _allowed(self, move: _Move) -> float:
        """The largest ratio of a design's error to that of the gains that run."""
        return MOST_LEFT if move.gain > 1.0 else self._most_left


def _ticks_until_rest(loop: Loop, sample_time: float) -> int:
    """How many ticks of this length [s] a step of a loop takes to die out, as many as are simulated at most."""
    horizon = default_horizon(loop) if stability(loop).stable else math.inf
    return min(math.ceil(horizon / sample_time), MOST_TICKS) if math.isfinite(horizon) else TICKS_WITHOUT_REST
