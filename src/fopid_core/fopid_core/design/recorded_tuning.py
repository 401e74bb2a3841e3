"""Gains from a record: the process is learnt from it, and so is what bounds the design: noise, limits, sample time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from fopid_core.design.defaults import process_gain
from fopid_core.design.identification.identified_model import IdentifiedModel
from fopid_core.design.identification.identify import IdentificationResult, behind_slow_actuator, identify
from fopid_core.design.identification.noise import SensorNoise, sensor_noise
from fopid_core.design.identification.noise_spectrum import NoiseSpectrum
from fopid_core.design.identification.record import Record
from fopid_core.design.loop_worth import noise_gain
from fopid_core.design.recorded_law import beside_what_ran, contradicts_law, made_prompt
from fopid_core.design.recorded_reach import RecordedReach, recorded_reach
from fopid_core.design.response_verification import held_to_record, no_objection, runs_away_instead
from fopid_core.design.robust_verification import (
    UNSEEN,
    RobustLimits,
    RobustTuning,
    as_held,
    first_request,
    tune_robustly,
)
from fopid_core.design.setpoint_weights import calmest_weights
from fopid_core.design.specification import (
    DERIVATIVE_WEIGHT,
    PROPORTIONAL_WEIGHT,
    Clock,
    TuningRequest,
    TuningResult,
)
from fopid_core.design.time.objectives import Objective
from fopid_core.design.time.proposal import settling_horizon
from fopid_core.design.tuner import tune
from fopid_core.errors import InputError
from fopid_core.model.indices import overshoot_pct
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process
from fopid_core.model.response import step_response

NOISE_SHARE, RECORDED_SHARE = 0.01, 0.05
"""Share of the control's range by which noise may move it, as a standard deviation; and of the range it had in the
record, where its limits are not known."""
HOLDING = 1.5
"""A bound on the control's peak leaves at least so many times what holds the setpoint."""
FILTER_ORDER = 2
SLOWER = (0.5, 0.25, 0.125)
"""Shares of a crossover that are tried where noise moves the control too much."""
CLEAR = 0.95
"""Share of the bound that is aimed at where a design broke it."""
FAR_OVER = 25.0
"""An overshoot [%] that nobody is to find out on the plant."""
MOST_LAM = 1.05
"""An integral of a higher order makes a loop cycle for ever where something sticks."""
MUCH_WORSE = 10.0
"""Nobody who has not said how fast a loop is to be wants one that leaves so many times the error of what ran."""
HOW_ELSE = (
    "a load, a gain that changes with the level, or a control or setpoint that is not told as it was makes that so; "
    "record without a load, in smaller moves"
)
"""What to do where the controller that ran would not hold what was learnt."""
_FINE = 0.1
"""Steps of so small a share of the noise are not worth a word."""
_NEAR = 0.05
"""A control that rests within this share of its range from a limit tells nothing of how far it may go."""


@dataclass(frozen=True)
class RecordedBounds:
    """What a record says that a design must respect; None where it says nothing.

    Attributes
    ----------
    sample_time : float
        [s]
    noise, noise_density : float
        Standard deviation of the measurement's noise, and its power spectral density: white at the record's samples.
    control_from_noise : float
        By how much noise may move the control, as a standard deviation.
    u_max, rate_max : float, optional
        What the limits leave for a unit step of the setpoint, so that the largest step of the record stays within.
    told : str
        Where all that is from, for a person.
    spectrum : NoiseSpectrum or None
        Of the noise; None where it may be white.
    """

    sample_time: float
    noise: float
    noise_density: float
    control_from_noise: float
    u_max: float | None
    rate_max: float | None
    told: str
    spectrum: NoiseSpectrum | None = None

    def options(self, method: str) -> dict[str, Any]:
        """They as fields of a request for this method."""
        found: dict[str, Any] = {"sample_time": self.sample_time}
        if method == "frequency" and self.u_max is not None:
            found["u_max"] = self.u_max
        if method != "time":
            return found
        found |= {name: getattr(self, name) for name in ("u_max", "rate_max") if getattr(self, name) is not None}
        if self.noise > 0.0:
            found |= {
                "noise_density": self.noise_density,
                "noise_rms_max": self.control_from_noise,
                "filter_order": FILTER_ORDER,
            }
        return found


@dataclass(frozen=True)
class RecordedTuning:
    """Gains from a record.

    Attributes
    ----------
    success : bool
    message : str
    identified : IdentificationResult
    noise : SensorNoise
    bounds : RecordedBounds or None
        None where no process was learnt.
    request : TuningRequest or None
        What was asked of the design, in the end.
    tuned : RobustTuning or None
        Verified on all that the record leaves possible.
    taken : mapping
        Fields of the request that the record gave.
    """

    success: bool
    message: str
    identified: IdentificationResult
    noise: SensorNoise
    bounds: RecordedBounds | None = None
    request: TuningRequest | None = None
    tuned: RobustTuning | None = None
    taken: Mapping[str, Any] = field(default_factory=dict)


def recorded_bounds(
    record: Record, process: Process, noise: SensorNoise, sample_time: float, unexplained: float = 0.0
) -> RecordedBounds:
    """What a record says beside its process.

    Parameters
    ----------
    record : Record
    process : Process
        Learnt from it, or known.
    noise : SensorNoise
    sample_time : float
        Of the controller as it will run [s].
    unexplained : float
        What the process leaves of the measurement, which counts as noise where it nowhere rests.
    """
    level = noise.level if noise.at_rest else unexplained
    if noise.at_rest or unexplained:
        seen = "at rest" if noise.at_rest else "as the model leaves it, since the measurement nowhere rests"
        heard = f"noise {level:.3g} {seen}"
    else:
        heard = "noise not known, since the measurement nowhere rests"
    parts = [f"sample time {sample_time:.4g} s", heard]
    if noise.spectrum:
        often = noise.spectrum.frequency[int(np.argmax(noise.spectrum.share))]
        parts.append(f"not white, most of it about {often:.3g} rad/s")
    if noise.step > _FINE * level:
        parts.append(f"quantised in steps of {noise.step:.3g}")
    room = record.control_max - record.control_min
    if math.isfinite(room):
        allowed, of = NOISE_SHARE * room, f"{100 * NOISE_SHARE:g} % of the range {room:.4g}"
    else:
        before = record.control_before
        if before is None and not np.ptp(record.control):
            before = 0.0  # as `identify` takes it: a step at the first sample
        allowed = RECORDED_SHARE * float(np.ptp(np.append(record.control, [] if before is None else [before])))
        of = f"{100 * RECORDED_SHARE:g} % of its moves in the record, which says no limits"
    if level > 0.0:
        parts.append(f"noise may move the control by {allowed:.3g}, {of}")
    step = _largest_step(record)
    u_max = _peak(record, process, step)
    rate_max = record.control_rate_max / step if step and math.isfinite(record.control_rate_max) else None
    if u_max is not None:
        parts.append(f"limits leave a control peak of {u_max:.4g} to a unit step, for steps of {step:.3g}")
    if rate_max is not None:
        parts.append(f"moves of {rate_max:.3g} a second to one")
    density = level**2 * record.sample_time
    return RecordedBounds(sample_time, level, density, allowed, u_max, rate_max, ", ".join(parts), noise.spectrum)


def _largest_step(record: Record) -> float:
    """Of the setpoint; where there is none, half of how far the measurement went."""
    moved = 0.0 if record.setpoint is None else float(np.abs(np.diff(record.setpoint)).max())
    return moved or 0.5 * float(np.ptp(record.measurement))


def _peak(record: Record, process: Process, step: float) -> float | None:
    """How far the control may go from where it mostly was, to the nearer limit, over a step."""
    usual, limits = float(np.median(record.control)), (record.control_min, record.control_max)
    room = min(abs(limit - usual) for limit in limits)
    wide = limits[1] - limits[0]
    if not (step and math.isfinite(room)) or (math.isfinite(wide) and room < _NEAR * wide):
        return None
    return max(room / step, HOLDING / abs(process.steady_state_gain))


def tune_recorded(
    record: Record,
    method: str,
    options: Mapping[str, Any] | None = None,
    limits: RobustLimits | None = None,
    template: str = "all",
    clock: Clock = time.perf_counter,
    identified: IdentificationResult | None = None,
    refuse: Callable[[TuningResult], str] = lambda _: "",
) -> RecordedTuning:
    """Learn the process from a record and tune on it, under the bounds that the record gives.

    Parameters
    ----------
    record : Record
    method : str
        ``frequency``, ``time`` or ``rule``.
    options : mapping, optional
        Fields of the request that somebody has given: they win over those of the record.
    limits : RobustLimits, optional
        What must hold on every process that the record leaves possible.
    template : str
        What to learn, as `identify` takes it.
    clock : callable
        Gives the time [s].
    identified : IdentificationResult, optional
        What was learnt from the record, if it was. Else, where what is learnt contradicts the frequency response that
        the record shows without a model, gains must hold for that response as well.
    refuse : callable
        Why a design may not be handed out, or nothing, as `tune_robustly` takes it.

    Examples
    --------
    >>> time = np.arange(0.0, 60.0, 0.5)
    >>> rest = 0.01 * np.random.default_rng(0).standard_normal(120)
    >>> moved = 2.0 * -np.expm1(-np.maximum(time - 20.0, 0.0) / 5.0)
    >>> found = tune_recorded(Record(time, time >= 20.0, moved + rest, control_max=5.0), "frequency", template="foptd")
    >>> found.success, found.taken["sample_time"], round(found.bounds.noise, 3)
    (True, 0.5, 0.01)
    """
    given = {name: value for name, value in (options or {}).items() if value is not None}
    limits, record = limits or RobustLimits(), made_prompt(record)
    noise, judges = sensor_noise(record), identified is None
    level = noise.level if noise.at_rest else 0.0
    identified = identified or _learnt(record, method, template, clock, level)
    record = replace(record, control_rate_max=min(record.control_rate_max, identified.flaws.rate))
    best = identified.best
    if not identified.success or best is None:
        return RecordedTuning(False, identified.message, identified, noise)
    against = contradicts_law(record, best.process) if judges and not identified.flaws.come_before else ""
    if against:
        return RecordedTuning(False, f"{identified.message}; {against}: {HOW_ELSE}", identified, noise)
    bounds = recorded_bounds(record, best.process, noise, given.get("sample_time", record.sample_time), best.noise)
    own = {**bounds.options(method), **(_with_load(best, given) if method == "time" else {})}
    if "noise_max" in given:
        own = {name: value for name, value in own.items() if not name.startswith("noise_")}
    taken = {name: value for name, value in own.items() if name not in given}
    request = TuningRequest(best.process, method, **{**own, **given})
    doubt, contradicted = (
        held_to_record(identified.behind_actuator(record), best, limits.ms_max, request.sample_time)
        if judges
        else ("", no_objection)
    )

    reach = recorded_reach(record, best) if judges else RecordedReach()

    def refused(tuning: TuningResult) -> str:
        return (
            refuse(tuning)
            or _cycles(tuning, identified)
            or contradicted(tuning.controller, tuning.filter)
            or reach.refusal(tuning.controller, tuning.filter)
        )

    def design(wanted: TuningRequest, first: TuningResult | None = None) -> tuple[TuningRequest, RobustTuning]:
        return _quiet(identified, wanted, given, limits, bounds, clock, refused, first)

    request, tuned = _within_reach(identified, request, reach, design)
    success, told = tuned.success, f"{doubt}; {tuned.message}" if doubt else tuned.message
    if not success and method != "time" and best.structure.runs_away:
        told = f"{told}; a process that runs away is a case for tune time"
    if success:
        tuned, calmed = _calmed(request, tuned)
        success, compared = _beside_what_ran(record, tuned, request, given) if judges else (True, "")
        linear = ", in a loop without what sticks" * bool(compared and identified.flaws.stick)
        told = f"{told}{calmed}{compared}{linear}"
    if success and tuned.tuning is not None and (moved := control_noise(best.process, tuned.tuning, bounds)):
        told = f"{told}; noise moves the control by {moved:.3g}"
        if moved > bounds.control_from_noise and _is_free(request, given):
            allowed = f"{bounds.control_from_noise:.3g} is allowed: no quieter design was found"
            filters = "; tune time chooses a filter as well" if method != "time" else ""
            success, told = False, f"{told}, {allowed}{filters}"
    message = f"{identified.message}; from the record: {bounds.told}; {told}"
    return RecordedTuning(success, message, identified, noise, bounds, request, tuned, taken)


def _within_reach(
    identified: IdentificationResult, request: TuningRequest, reach: RecordedReach,
    design: Callable[..., tuple[TuningRequest, RobustTuning]],
) -> tuple[TuningRequest, RobustTuning]:  # fmt: skip
    """The design, within ranges of its gains where it works faster than the record shows, or comes to nothing."""
    best = identified.best
    if request.method != "time" or best is None or best.structure.runs_away:
        return design(request)
    boxes = reach.boxes(best.process)
    if not boxes:
        return design(request)
    first = tune(first_request(identified, request))
    too_fast = reach.refusal(first.controller, first.filter)  # no tighter bound on max |S| makes it slower
    found = design(_within(request, boxes.pop(0))) if too_fast else design(request, first)
    while boxes and not found[1].success:
        found = design(_within(request, boxes.pop(0)))
    return found


def _within(request: TuningRequest, box: Mapping[str, tuple[float, float]]) -> TuningRequest:
    """The request with ranges of the gains; a derivative of a low order would be a gain that they do not hold."""
    if request.structure:
        return replace(request, bounds={**box, **request.bounds})
    none = {name: 0.0 for name, (low, high) in box.items() if low == high}
    said, ranges = {*request.fixed, *request.bounds}, {name: range_ for name, range_ in box.items() if name not in none}
    fixed = {name: value for name, value in {**none, "mu": 1.0}.items() if name not in said}
    return replace(request, bounds={**ranges, **request.bounds}, fixed={**fixed, **request.fixed})


def _cycles(tuning: TuningResult, identified: IdentificationResult) -> str:
    """Why a design cycles behind what the record shows of the actuator; empty where it does not."""
    lam = tuning.controller.lam if tuning.controller else 0.0
    if lam <= MOST_LAM or not identified.flaws.stick:
        return ""
    told = f"lam = {lam:.3g}, with which a loop goes on cycling behind play, stiction or friction"
    return f"{told}; allowed: up to {MOST_LAM:g}, as tune time --fix lam=1 has it"


def _beside_what_ran(
    record: Record, tuned: RobustTuning, request: TuningRequest, given: Mapping[str, Any]
) -> tuple[bool, str]:
    """Whether a design may stand beside the controller that ran, and what is said of it, where the record shows it."""
    beside = beside_what_ran(record, request.process, tuned.tuning) if tuned.tuning else math.nan
    if not math.isfinite(beside):
        closed = record.setpoint is not None and np.ptp(record.setpoint) > 0.0
        told = "; not compared with the controller that ran, which the record does not show closely"
        return True, told * bool(closed)
    told = f"; after a load it leaves {beside:.3g} times the error of the controller that ran, as the record shows it"
    if beside <= MUCH_WORSE or not _is_free(request, given):
        return True, told
    told = f"{told}; allowed: up to {MUCH_WORSE:g} times, where nobody says how fast it is to be"
    return False, told + "; tune time counts the load" * (request.method != "time")


def _learnt(record: Record, method: str, template: str, clock: Clock, noise: float) -> IdentificationResult:
    """The process of a record, for a design by a method.

    Behind a limit on the actuator's moves where the method can keep it: a process looks slower than it is in large
    moves with one. Where it cannot, that is said, and the design is for the slower one.
    """
    found = identify(record, template, clock, noise)
    if template != "all" or not found.success or found.best is None:
        return found
    found = runs_away_instead(found.behind_actuator(record), found.best, noise) or found
    if found.best is None or (found.best.whiteness.white and not found.best.wanders):
        return found
    slow = behind_slow_actuator(record, found, noise=noise)
    if slow is None or method == "time":
        return slow or found
    limit = f"the actuator seems to move by no more than {slow.flaws.rate:.3g} a second"
    return replace(found, message=f"{found.message}; {limit}, which tune {method} does not keep to: tune time does")


def _calmed(request: TuningRequest, tuned: RobustTuning) -> tuple[RobustTuning, str]:
    """A time-domain design with calmer setpoint weights where a step would overshoot far, and what is said of that.

    An index such as ITAE hardly counts what a kick makes of the first moments.
    """
    tuning, named = tuned.tuning, {*request.fixed, *request.bounds} & {PROPORTIONAL_WEIGHT, DERIVATIVE_WEIGHT}
    are_given = named or request.two_degrees is False or not request.filter_order
    if tuning is None or tuning.controller is None or request.method != "time":
        return tuned, ""
    loop = Loop(as_held(request.process, request.sample_time), tuning.controller, tuning.filter, tuning.weights)
    horizon = request.horizon or settling_horizon(request.process)
    try:
        before = overshoot_pct(step_response(loop, horizon).output)
        if before <= FAR_OVER:
            return tuned, ""
        calm = tuning.weights if are_given else calmest_weights(loop, horizon, request.sample_time)
        after = overshoot_pct(step_response(replace(loop, weights=calm), horizon).output)
    except InputError:  # near the border of stability it is not known
        return tuned, ""
    said = f"; a step of the setpoint overshoots by {after:.0f} %" if after > FAR_OVER else ""
    if calm != tuning.weights:
        weights = f"setpoint weights {calm.proportional:.3g} and {calm.derivative:.3g}"
        said = f"{said}; {weights}: with those that cost least a step would overshoot by {before:.0f} %"
    return replace(tuned, tuning=replace(tuning, weights=calm)), said


def _with_load(best: IdentifiedModel, given: Mapping[str, Any]) -> dict[str, Any]:
    """A load counts as well, as much as what moves the measurement alike, where the record shows no slow end.

    A setpoint asks for no integral then, and without one a load stays for ever.
    """
    at_work = abs(complex(best.process(1j * best.crossover)))
    unseen = abs(best.process.steady_state_gain) >= UNSEEN * at_work
    is_integral = Objective.of(given.get("index", "itae"), {}).is_integral
    weight = abs(process_gain(best.process)) / at_work  # a search takes a load of 1 over that gain
    return {"input": "both", "load_weight": weight} if unseen and is_integral else {}


def _quiet(
    identified: IdentificationResult, request: TuningRequest, given: Mapping[str, Any], limits: RobustLimits,
    bounds: RecordedBounds, clock: Clock, refuse: Callable[[TuningResult], str], first: TuningResult | None = None,
) -> tuple[TuningRequest, RobustTuning]:  # fmt: skip
    """The design, or a quieter one where noise moves the control too far and nobody has said what decides that."""
    tuned = tune_robustly(identified, request, limits, clock, first, refuse)
    first = tuned.tuning
    if first is None or first.achieved is None or not _is_free(request, given):
        return request, tuned
    for share in SLOWER:
        excess = control_noise(request.process, tuned.tuning, bounds) / max(bounds.control_from_noise, 1e-300)
        if excess <= 1.0:
            break
        if request.method == "frequency":
            request = replace(request, crossover=share * first.achieved.crossover)
        elif request.noise_rms_max is not None:  # by as much less as sampling adds to it
            request = replace(request, noise_rms_max=CLEAR * request.noise_rms_max / excess)
        tuned = tune_robustly(identified, request, limits, clock, refuse=refuse)
    return request, tuned


def _is_free(request: TuningRequest, given: Mapping[str, Any]) -> bool:
    """Whether nobody has said what decides how far noise moves the control."""
    in_time = ("noise_max", "noise_rms_max", "filter_order")
    decide = {"frequency": ("crossover",), "time": in_time, "rule": ("rule", "crossover")}[request.method]
    return not any(name in given for name in decide)


def control_noise(process: Process, tuning: TuningResult | None, bounds: RecordedBounds) -> float:
    """By how much noise moves the control of a design, as a standard deviation; 0 without a design or noise."""
    if tuning is None or tuning.controller is None or not bounds.noise:
        return 0.0
    loop = Loop(process, tuning.controller, tuning.filter, tuning.weights)
    return bounds.noise * noise_gain(loop, bounds.sample_time, bounds.spectrum)
