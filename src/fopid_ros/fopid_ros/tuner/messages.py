"""Between the tuner's messages and the core's requests and results."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from fopid_core.design.specification import Bound, TuningRequest
from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.margins import margins
from fopid_core.model.process import TEST_BENCH, Process
from fopid_core.model.stability import stability
from fopid_core.model.two_degrees import NO_FILTER, MeasurementFilter, SetpointWeights
from fopid_core.runtime.settings import LARGEST, UNPACED, Pace
from fopid_msgs.action import Autotune
from fopid_msgs.msg import ComparisonRow, Gains, LoopMeasures, Proposal, TwoDegrees
from fopid_msgs.msg import IdentifiedModel as IdentifiedModelMessage
from fopid_msgs.srv import Compare, Tune
from fopid_ros.common.design_parameters import DEADBAND, GAINS, PACE
from fopid_ros.common.inputs import is_number
from fopid_ros.tuner.controller_client import RunningDesign

if TYPE_CHECKING:  # loaded by the first request that learns, since they need scipy
    from fopid_core.design.comparison.compare import Comparison
    from fopid_core.design.comparison.measures import Row
    from fopid_core.design.identification.identified_model import IdentifiedModel
    from fopid_core.design.improvement import Candidate
    from fopid_core.design.tuner import TuningResult
    from fopid_ros.tuner.learning.autotune_request import AutotuneRequest
    from fopid_ros.tuner.learning.gain_update import AcceptanceCriteria, Outcome, Trial

WEIGHTING = ("chosen", "one")
"""What may be asked of the setpoint weights."""
COLUMNS = ("iae_setpoint", "iae_load", "ms", "mt", "noise_gain", "overshoot_pct", "settling_time", "control_peak",
           "total_variation", "overshoot_spread_pct", "delay_margin", "running_ms")  # fmt: skip
"""Measures of a row of a comparison."""
ALLOWED_PROCESS = "P1 ... P4 or a transfer function in s"


def process_of(text: str) -> Process:
    """The process that a message or a parameter names: a text, never a file.

    Raises
    ------
    InputError
        If it cannot be read.

    Examples
    --------
    >>> str(process_of("1/(2s+1)"))
    '1/(2 s + 1)'
    """
    name = text.strip()
    if not name:
        raise InputError(f"process = ''; allowed: {ALLOWED_PROCESS}, here or as the tuner's parameter")
    if name.endswith((".yaml", ".yml")):
        raise InputError(f"process = {name!r}; allowed: {ALLOWED_PROCESS}; files are not read for others")
    return Process.parse(TEST_BENCH.get(name, text))


def _given(request: Any, defaults: dict[str, Any], name: str) -> Any:
    """The request's field, or the parameter of that name where the field is zero or empty; None if both are."""
    return getattr(request, name) or defaults[name] or None


def autotune_request(goal: Autotune.Goal, defaults: dict[str, Any]) -> AutotuneRequest:
    """What ~/autotune is asked, from the action's goal and the node's parameters.

    Raises
    ------
    InputError
        Naming the field that cannot be used.
    """
    from fopid_core.design.identification.structure import structure_of
    from fopid_ros.tuner.learning.autotune_request import AutotuneRequest
    from fopid_ros.tuner.learning.closed_loop_experiment import EXCITATIONS, ExperimentSettings

    for name in ("amplitude", "deviation_max", "duration"):
        if not 0.0 <= getattr(goal, name) < math.inf:
            raise InputError(f"{name} = {getattr(goal, name)}; allowed: 0 to choose it from the loop, or above 0")
    chosen = {name: getattr(goal, name) or defaults[f"autotune.{name}"]
              for name in ("excitation", "amplitude", "deviation_max", "duration")}  # fmt: skip
    if chosen["excitation"] not in EXCITATIONS:
        raise InputError(f"excitation = {chosen['excitation']!r}; allowed: {', '.join(EXCITATIONS)}")
    template = goal.template_name or "all"
    for name in template.split(",") if template != "all" else ():
        structure_of(name)  # says at once, and not after the experiment, that there is none of that name
    shared = {name: getattr(goal, name)
              for name in ("method", "phase_margin", "crossover", "index", "ms_max", "u_max")}  # fmt: skip
    # The process to tune for is what will be learnt; until then any stands for it.
    tuning = tuning_request(Tune.Request(process="P1", **shared), defaults)
    wanted = criteria(tuning, defaults, compare=not goal.method)
    trial = trial_of(goal, defaults)
    chosen |= {"until_known": defaults["autotune.until_known"], "proved": trial is None and not goal.propose_only}
    second = defaults["autotune.second_round"]
    return AutotuneRequest(ExperimentSettings(**chosen), template, wanted, goal.propose_only, trial, second)


def trial_of(goal: Autotune.Goal, defaults: dict[str, Any]) -> Trial | None:
    """The gains that a goal asks to try, judged on their process; None when it names none.

    Raises
    ------
    InputError
        Saying why they must not be tried.
    """
    from fopid_ros.tuner.learning.gain_update import Trial

    numbers = [getattr(goal.gains, name) for name in GAINS]
    if not any(numbers):
        return None
    if not all(map(is_number, numbers)):
        raise InputError(f"gains = {numbers}; allowed: finite numbers")
    gains = Fopid(*numbers)
    design = RunningDesign(gains, pace=_pace_of(goal), deadband=goal.deadband or None)
    if goal.two_degrees_given:
        asked = goal.two_degrees
        design = replace(
            design, filter=MeasurementFilter(asked.measurement_filter_order, asked.measurement_filter_time),
            weights=SetpointWeights(asked.setpoint_weight, asked.derivative_setpoint_weight),
        )  # fmt: skip
    loop = Loop(process_of(goal.process or defaults["process"]), gains, design.filter)
    verdict = stability(loop)
    if not verdict.stable:
        raise InputError(f"gains = {gains}: the loop would not be stable; allowed: gains that hold {loop.process}")
    found = margins(loop)
    if not found.ms <= defaults["verify.ms_max"]:
        raise InputError(f"gains = {gains}: max |S| {found.ms:.3g}; allowed: up to {defaults['verify.ms_max']:g}")
    if not 0.0 < found.crossover < math.inf:
        raise InputError(f"gains = {gains}: no gain crossover; allowed: gains of which the loop responds")
    return Trial(design, 2.0 / found.crossover)


def _pace_of(goal: Autotune.Goal) -> Pace | None:
    """How fast control and setpoint may move with the gains of a goal; None for as it is."""
    for name in (*PACE, DEADBAND):
        if not 0.0 <= getattr(goal, name) <= LARGEST:
            raise InputError(f"{name} = {getattr(goal, name)}; allowed: 0 for as it is, or above 0, up to {LARGEST:g}")
    pace = Pace(*(getattr(goal, name) or math.inf for name in PACE))
    return None if pace == UNPACED else pace


def criteria(tuning: TuningRequest, defaults: dict[str, Any], compare: bool = False) -> AcceptanceCriteria:
    """What gains for a learnt process must fulfil, by the node's parameters; whether methods are compared."""
    from fopid_core.design.robust_verification import RobustLimits
    from fopid_ros.tuner.learning.gain_update import AcceptanceCriteria

    limits = RobustLimits(defaults["verify.worst_ms_max"], defaults["verify.worst_phase_margin"])
    # Adaptation designs without filter and weights; a comparison of methods chooses both.
    plain = replace(tuning, filter_order=0, two_degrees=False)
    return AcceptanceCriteria(
        plain, limits, defaults["verify.ticks"], defaults["verify.certify"], compare, defaults["verify.noise_share"],
        defaults["verify.region"], defaults["verify.confidence"],
    )  # fmt: skip


def tuning_request(request: Tune.Request, defaults: dict[str, Any]) -> TuningRequest:
    """The core's request from a service request and the node's parameters.

    Raises
    ------
    InputError
        Naming the field that cannot be used.
    """
    process = process_of(request.process or defaults["process"])
    bounds: dict[str, Any] = {}
    for name in ("t_max", "s_max"):
        frequency = _given(request, defaults, f"{name}_frequency")
        db = getattr(request, f"{name}_db") or defaults[f"{name}_db"]
        bounds[name] = Bound(db, frequency) if frequency is not None else None
        if frequency is None and getattr(request, f"{name}_db"):
            raise InputError(f"{name}_frequency = 0; allowed: above 0 rad/s, since {name}_db is given")
    numbers = {name: _given(request, defaults, name)
               for name in ("phase_margin", "crossover", "horizon", "ms_max", "u_max", "mt_max", "noise_max", "rule",
                            "structure", "timeout")}  # fmt: skip
    words = {name: _given(request, defaults, name) for name in ("method", "via", "index", "input")}
    weighted = _given(request, defaults, "setpoint_weights")
    if weighted not in (None, *WEIGHTING):
        raise InputError(f"setpoint_weights = {weighted!r}; allowed: {', '.join(WEIGHTING)}")
    return TuningRequest(
        process, sample_time=defaults["sample_time"], filter_order=request.filter_order or defaults["filter_order"],
        two_degrees=None if weighted is None else weighted == "chosen", **bounds, **numbers, **words,
    )  # fmt: skip


def comparison_arguments(request: Compare.Request, defaults: dict[str, Any]) -> tuple[TuningRequest, str, float | None]:
    """What ``~/compare`` is asked: the core's request, what is preferred, and what more numbers must gain, if told.

    Raises
    ------
    InputError
        Naming the field that cannot be used.
    """
    from fopid_core.design.comparison.compare import comparison_request

    names = ("ms_max", "mt_max", "noise_max", "u_max", "horizon", "filter_order")
    bounds = {name: _given(request, defaults, name) for name in names}
    known = {name: value for name, value in bounds.items() if value is not None}
    process = process_of(request.process or defaults["process"])
    asked = comparison_request(process, sample_time=defaults["sample_time"], **known)
    return asked, request.prefer or "balanced", request.worth or None


def fill_comparison(response: Compare.Response, found: Comparison) -> None:
    """What a comparison came to."""
    response.success, response.message = found.recommended >= 0, found.reason
    response.recommended, response.elapsed = found.recommended, found.elapsed
    response.rows = [_comparison_row(row) for row in found.rows]


def _comparison_row(row: Row) -> ComparisonRow:
    candidate = row.candidate
    message = nothing_known(ComparisonRow(method=candidate.method, structure=candidate.structure))
    if candidate.loop is not None:
        fill_gains(message.gains, candidate.loop.controller)
        fill_two_degrees(message.two_degrees, candidate.loop.filter, candidate.loop.weights)
    for name in COLUMNS:
        setattr(message, name, float(getattr(row, name)))
    message.stable, message.within, message.running_stable = row.stable, row.is_within, row.running_stable is True
    message.unmet, message.reason = list(row.unmet), candidate.reason
    return message


def nothing_known(message: Any) -> Any:
    """The message with NaN for each number that is not known yet: gains, and what a loop with them is worth."""
    for name in ("gains", "previous_gains", "achieved", "two_degrees", "previous_two_degrees"):
        part = getattr(message, name, None)
        for field, kind in part.get_fields_and_field_types().items() if part is not None else ():
            if kind == "double":
                setattr(part, field, math.nan)
    if hasattr(message, "achieved"):
        message.achieved.unstable_poles = -1
    if hasattr(message, "worst_ms"):
        message.worst_ms = math.nan
    if hasattr(message, "recommended"):
        message.recommended = -1
    return message


def fill_gains(message: Gains, controller: Fopid) -> None:
    """The five numbers."""
    for name, value in zip(GAINS, controller.gains, strict=True):
        setattr(message, name, value)


def fill_two_degrees(
    message: TwoDegrees, measured: MeasurementFilter = NO_FILTER, weights: SetpointWeights | None = None
) -> None:
    """Filter and setpoint weights; weights that are not known stay NaN."""
    message.measurement_filter_order, message.measurement_filter_time = measured.order, measured.time
    if weights is not None:
        message.setpoint_weight, message.derivative_setpoint_weight = weights.proportional, weights.derivative


def fill_previous(message: Any, previous: RunningDesign) -> None:
    """What the controller ran before, into whatever tells it."""
    fill_gains(message.previous_gains, previous.gains)
    if hasattr(message, "previous_two_degrees"):
        fill_two_degrees(message.previous_two_degrees, previous.filter, previous.weights)


def fill_measures(message: LoopMeasures, result: TuningResult) -> None:
    """What the loop is worth; a measure that does not exist stays NaN."""
    message.stable, message.cost = result.stable, result.cost
    message.unstable_poles = -1 if result.controller is None else result.unstable_poles
    if result.achieved is None:
        return
    for name in ("phase_margin", "crossover", "phase_slope", "gain_margin_db", "delay_margin", "ms", "mt",
                 "t_db", "s_db", "noise_gain"):  # fmt: skip
        setattr(message, name, float(getattr(result.achieved, name)))
    if result.running is not None:
        message.running_stable, message.running_ms = bool(result.running.stable), result.running.ms


def identified_message(model: IdentifiedModel) -> IdentifiedModelMessage:
    """A learnt process for others."""
    return IdentifiedModelMessage(
        template_name=model.template, process=str(model.process), names=list(model.parameters),
        values=list(model.parameters.values()), deviations=[model.deviations[name] for name in model.parameters],
        fit_pct=model.fit_pct, white=bool(model.whiteness.white),
    )  # fmt: skip


def proposal_message(candidate: Candidate, deadband: float = 0.0) -> Proposal:
    """What one method found, for others; and the errors that are to count as none with it."""
    message, tuned, worth = nothing_known(Proposal()), candidate.tuned, candidate.worth
    message.name, message.accepted, message.message = candidate.name, not candidate.refusal, candidate.refusal
    if tuned.tuning is not None and tuned.tuning.controller is not None:
        fill_gains(message.gains, tuned.tuning.controller)
        fill_two_degrees(message.two_degrees, tuned.tuning.filter, tuned.tuning.weights)
        fill_measures(message.achieved, tuned.tuning)
    for name, most in zip(PACE, (candidate.pace.control, candidate.pace.setpoint), strict=True):
        setattr(message, name, most if math.isfinite(most) else 0.0)
    message.deadband = deadband
    if tuned.robustness is not None:
        message.worst_ms = tuned.robustness.ms
    if worth is not None:
        message.setpoint_iae, message.load_iae, message.noise_gain = worth.setpoint, worth.load, worth.noise_gain
    return message


def fill_autotune_result(message: Autotune.Result, outcome: Outcome) -> None:
    """What an autotuning came to."""
    message.success, message.message = outcome.success, outcome.message
    message.applied, message.rolled_back = outcome.applied, outcome.rolled_back
    if outcome.model is not None:
        message.model = identified_message(outcome.model)
    models = sorted(outcome.models, key=lambda model: (model is not outcome.model, -model.fit_pct))
    message.models = [identified_message(model) for model in models]
    known = [one for one in outcome.candidates if one.worth is not None]
    message.proposals = [proposal_message(one, outcome.deadband) for one in known]
    if outcome.previous is not None:
        fill_previous(message, outcome.previous)
    if outcome.tuned is None or outcome.tuning is None:
        return
    if outcome.tuning.controller is not None:
        fill_gains(message.gains, outcome.tuning.controller)
    fill_measures(message.achieved, outcome.tuning)
    if outcome.tuned.robustness is not None:
        message.worst_ms = outcome.tuned.robustness.ms
