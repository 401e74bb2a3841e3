"""What is asked of a tuning, and what comes back."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field

from fopid_core import notebook
from fopid_core.design.sampled_loop import Running
from fopid_core.errors import InputError, did_you_mean
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process
from fopid_core.model.two_degrees import (
    FILTER_ORDERS,
    LONGEST_FILTER,
    NO_FILTER,
    WHOLE_SETPOINT,
    MeasurementFilter,
    SetpointWeights,
)

METHODS = ("frequency", "time", "rule")
VIA = ("none", "foptd", "soptd", "nioptd1", "nioptd2")
CRITERIA = ("peaks", "ms", "flatness")
FREQUENCY_SOLVERS = ("square", "paper", "monje")
TIME_SOLVERS = ("gauss-newton", "nelder-mead", "differential-evolution")
INPUTS = ("setpoint", "load", "both")
STRUCTURES: Mapping[str, Mapping[str, float]] = {
    "p": {"ki": 0.0, "kd": 0.0, "lam": 1.0, "mu": 1.0},
    "pi": {"kd": 0.0, "lam": 1.0, "mu": 1.0},
    "pd": {"ki": 0.0, "lam": 1.0, "mu": 1.0},
    "pid": {"lam": 1.0, "mu": 1.0},
    "fopi": {"kd": 0.0, "mu": 1.0},
    "fopd": {"ki": 0.0, "lam": 1.0},
    "fopid": {},
}
"""The controllers by name, by the numbers they keep."""
NUMBERS = ("kp", "ki", "kd", "lam", "mu")
FILTER_TIME, PROPORTIONAL_WEIGHT, DERIVATIVE_WEIGHT = "filter_time", "setpoint_weight", "derivative_setpoint_weight"
VARIABLES = (*NUMBERS, FILTER_TIME, PROPORTIONAL_WEIGHT, DERIVATIVE_WEIGHT)
"""The five numbers; the time of the filter of the measurement [s], and the two weights of the setpoint."""

LEAST_BOUND = 1e-100  # beside less, no quotient fits a number
PRACTICAL = (1e-12, 1e12)
"""Times [s] and frequencies [rad/s] that can be asked for."""

Progress = Callable[[float, str], None]
"""Called with the share of the work done, 0 to 1, and what is being done."""

Expired = Callable[[], bool]
"""Whether the time allowed is over."""

Clock = Callable[[], float]
"""A clock that only goes forward [s]."""


def no_progress(share: float, what: str) -> None:
    """Report to nobody."""
    del share, what


@dataclass(frozen=True)
class Bound:
    """A bound on |T| for every frequency at or above, or on |S| for every frequency at or below, a given one.

    Attributes
    ----------
    db : float
        The bound [dB].
    frequency : float
        Where its band begins (for T, eq. (4)) or ends (for S, eq. (5)) [rad/s].
    """

    db: float
    frequency: float

    def __post_init__(self) -> None:
        require(math.isfinite(self.db), "bound", self.db, "a finite number of dB")
        _require_practical("frequency of the bound", self.frequency, "rad/s")

    def __str__(self) -> str:
        return f"{self.db:g} dB at {self.frequency:g} rad/s"


@dataclass(frozen=True)
class Bounds:
    """What a loop must keep.

    Attributes
    ----------
    ms_max, mt_max : float
        On max |S| and max |T|; infinite for none.
    noise_max : float
        On max |C S| up to the Nyquist frequency of the controller.
    t_max, s_max : Bound, optional
        On |T| above and |S| below a frequency.
    u_max, rate_max : float
        On the control after a unit setpoint step, of the controller as it runs, and on its moves per second.
    sample_time : float
        Its tick [s].
    horizon : float
        Up to which the whole control counts [s]; 0 for the control at the step itself.
    noise_density, noise_rms_max : float
        Power spectral density of white noise of the measurement [unit^2/Hz], and the bound on the root mean square
        of the control that it makes up to the Nyquist frequency.
    """

    ms_max: float = math.inf
    mt_max: float = math.inf
    noise_max: float = math.inf
    t_max: Bound | None = None
    s_max: Bound | None = None
    u_max: float = math.inf
    sample_time: float = 0.01
    horizon: float = 0.0
    rate_max: float = math.inf
    noise_density: float = 0.0
    noise_rms_max: float = math.inf


@dataclass(frozen=True)
class FrequencySpecification:
    """What eqs. (1) to (5) ask for.

    Attributes
    ----------
    phase_margin : float
        [rad], eq. (1).
    crossover : float
        [rad/s], eq. (2).
    t_max, s_max : Bound, optional
        Eqs. (4) and (5).
    criterion : str
        What is best among the designs that meet them: the smallest ``peaks``, the larger of max |S| and max |T|;
        the smallest ``ms`` = max |S|; or the widest ``flatness`` of the phase, eq. (3).
    u_max : float
        Bound on the control right after a unit setpoint step, of the controller as it runs at ``sample_time`` [s].
    load_left_max : float
        Bound on what a load has left in the end, see ``load_tail``.
    practical : bool
        Whether kp and the orders are to be off their edges, where nobody would trust them.
    """

    phase_margin: float
    crossover: float
    t_max: Bound | None = None
    s_max: Bound | None = None
    criterion: str = "peaks"
    u_max: float = math.inf
    sample_time: float = 0.01
    load_left_max: float = math.inf
    practical: bool = False

    def __post_init__(self) -> None:
        _require_angle(self.phase_margin)
        require(0 < self.crossover < math.inf, "crossover", self.crossover, "above 0 rad/s")
        one_of("criterion", self.criterion, CRITERIA)


@dataclass(frozen=True)
class TuningRequest:
    """A tuning to be done; what is None is chosen from the process, and the result's message says how.

    Attributes
    ----------
    process : Process
        What is to be controlled.
    method : str
        ``frequency`` (eqs. (1) to (5)), ``time`` (eqs. (23) to (30)) or ``rule``.
    phase_margin, crossover : float, optional
        For ``frequency``: [rad] and [rad/s].
    t_max, s_max : Bound, optional
        For ``frequency``: bounds on |T| and |S|, met over their whole bands.
    via : str
        For ``frequency``: the template the process is reduced to first, or ``none``.
    criterion : str
        For ``frequency``: among all designs that meet the specification take the one with the smallest
        ``peaks`` of |S| and |T|, the smallest ``ms`` or the widest ``flatness`` of the phase.
    index : str
        For ``time``: ``iae ise itae itse istes istse sum``, ``zamani`` or ``energy`` (with ``weights``).
    horizon : float, optional
        For ``time``: the time the index is integrated over [s].
    u_max : float, optional
        Bound on the peak of the control after a unit setpoint step, for the controller as it runs at
        ``sample_time``; infinite for none. (For ``frequency``: the control at the step itself.)
    ms_max, mt_max, noise_max : float, optional
        For ``time``: bounds on max |S|, max |T|, and on the gain from measurement noise to control at
        ``sample_time``; infinite for none.
    rate_max : float, optional
        For ``time``: bound on the control's moves per second after a unit setpoint step.
    noise_density, noise_rms_max : float, optional
        For ``time``: power spectral density of white noise of the measurement [unit^2/Hz], and a bound on the root
        mean square of the control that it makes.
    input : str
        For ``time``: the step whose response counts, ``setpoint``, ``load`` or ``both``.
    load_weight : float
        For ``both``: weight of the load's index against the setpoint's.
    structure : str, optional
        For ``time``: ``p pi pd pid fopi fopd fopid``; when not given, the simplest that costs hardly more.
    filter_order : int, optional
        For ``time``: order of the filter of the measurement, whose time is then chosen; 0 for none; when not given,
        none where that does.
    two_degrees : bool, optional
        For ``time``: whether the weights of the setpoint are chosen; when not given, where the load or a filter counts.
    sample_time : float
        The tick of the controller as it will run [s].
    fixed : mapping
        For ``time``: any of kp, ki, kd, lam, mu that shall keep a value; ``{"lam": 1, "mu": 1}`` is plain PID. Also
        filter_time, setpoint_weight, derivative_setpoint_weight.
    bounds : mapping
        For ``time``: (low, high) for any of them, in place of the default box.
    weights : mapping
        For ``time`` with ``sum``, ``zamani`` or ``energy``: weights of the parts.
    rule : str, optional
        For ``rule``: its name.
    start : Fopid, optional
        For ``time``: a further point to begin from.
    solver : str, optional
        ``square``, ``paper`` or ``monje`` for ``frequency``; ``gauss-newton``, ``nelder-mead`` or
        ``differential-evolution`` for ``time``.
    seed : int
        For ``time``: seed of the search; the same seed gives the same answer.
    timeout : float, optional
        Give the best found after this long [s], marked unsuccessful.
    sampled : Process, optional
        What the controller samples, where ``process`` counts the hold of the control as a delay; else ``process``.
    as_it_runs : bool
        For ``time``: whether max |S| is bounded as the loop runs, sampled, as well; needs ``sampled``.
    """

    process: Process
    method: str = "frequency"
    phase_margin: float | None = None
    crossover: float | None = None
    t_max: Bound | None = None
    s_max: Bound | None = None
    via: str = "none"
    criterion: str = "peaks"
    index: str = "itae"
    horizon: float | None = None
    ms_max: float | None = None
    u_max: float | None = None
    noise_max: float | None = None
    sample_time: float = 0.01
    fixed: Mapping[str, float] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    weights: Mapping[str, float] = field(default_factory=dict)
    rule: str | None = None
    start: Fopid | None = None
    solver: str | None = None
    seed: int = 0
    timeout: float | None = None
    mt_max: float | None = None
    rate_max: float | None = None
    noise_density: float | None = None
    noise_rms_max: float | None = None
    input: str = "setpoint"
    load_weight: float = 1.0
    structure: str | None = None
    filter_order: int | None = None
    two_degrees: bool | None = None
    sampled: Process | None = None
    as_it_runs: bool = False

    def __post_init__(self) -> None:
        one_of("method", self.method, METHODS)
        one_of("via", self.via, VIA)
        one_of("criterion", self.criterion, CRITERIA)
        if self.solver is not None:
            one_of("solver", self.solver, {"frequency": FREQUENCY_SOLVERS, "time": TIME_SOLVERS}.get(self.method, ()))
        if self.phase_margin is not None:
            _require_angle(self.phase_margin)
        for name, unit in (("crossover", "rad/s"), ("horizon", "s"), ("sample_time", "s"), ("timeout", "s")):
            _require_practical(name, getattr(self, name), unit)
        one_of("input", self.input, INPUTS)
        if self.structure is not None:
            one_of("structure", self.structure, tuple(STRUCTURES))
        require(self.filter_order in (None, *FILTER_ORDERS), "filter_order", self.filter_order, "0, 1 or 2")
        require(0.0 < self.load_weight < math.inf, "load_weight", self.load_weight, "above 0")
        others = ("mt_max", "u_max", "noise_max", "noise_rms_max", "rate_max")
        bounds = {"ms_max": 1.0, **dict.fromkeys(others, LEAST_BOUND)}
        for name, least in bounds.items():
            bound = getattr(self, name)
            require(bound is None or bound > least, name, bound, f"above {least:g}, inf for none")
        density = self.noise_density
        require(density is None or 0.0 < density < math.inf, "noise_density", density, "above 0 unit^2/Hz")
        both = (density is None) == (self.noise_rms_max is None)
        require(both, "noise_density, noise_rms_max", (density, self.noise_rms_max), "both or neither")
        self._check_numbers()

    def _check_numbers(self) -> None:
        for name, value in self.fixed.items():
            one_of("fixed", name, VARIABLES)
            require(name != FILTER_TIME or bool(self.filter_order), "fixed filter_time", value, "with a filter_order")
            require(math.isfinite(value), f"fixed {name}", value, "a finite number")
        for name, (low, high) in self.bounds.items():
            one_of("bounds", name, VARIABLES)
            require(name != FILTER_TIME or bool(self.filter_order), "bounds of filter_time", low, "with a filter_order")
            require(
                math.isfinite(low) and math.isfinite(high) and low <= high,
                f"bounds of {name}",
                (low, high),
                "two finite numbers, the lower one first",
            )
        ranges = {"lam": 2.0, "mu": 2.0, FILTER_TIME: LONGEST_FILTER, PROPORTIONAL_WEIGHT: 1.0, DERIVATIVE_WEIGHT: 1.0}
        for name, most in ranges.items():
            for value in (*self.bounds.get(name, ()), *([self.fixed[name]] if name in self.fixed else [])):
                require(0 <= value <= most, name, value, f"0 to {most:g}")


@dataclass(frozen=True)
class Achieved:
    """What a loop does; nan where it has no meaning or was not asked for.

    Attributes
    ----------
    phase_margin, crossover, phase_slope : float
        At the lowest phase margin [rad], [rad/s], [rad/(rad/s)].
    gain_margin_db, delay_margin : float
        [dB] and [s].
    ms, mt : float
        max |S| and max |T|.
    t_db, s_db : float
        Largest |T| and |S| on the bands of the bounds [dB].
    noise_gain : float
        Largest |C F S|, from noise of the measurement to the control, up to the Nyquist frequency.
    noise_rms : float
        Root mean square of the control that noise of the given density makes.
    """

    phase_margin: float
    crossover: float
    phase_slope: float
    gain_margin_db: float
    delay_margin: float
    ms: float
    mt: float
    t_db: float = math.nan
    s_db: float = math.nan
    noise_gain: float = math.nan
    noise_rms: float = math.nan

    @property
    def phase_margin_deg(self) -> float:
        """The phase margin [deg]."""
        return math.degrees(self.phase_margin)

    def _repr_html_(self) -> str:
        return notebook.table("Achieved", {"phase_margin_deg": self.phase_margin_deg, **asdict(self)})


@dataclass(frozen=True)
class TuningResult:
    """The answer to a tuning request.

    Attributes
    ----------
    success : bool
        Every specification is met and the loop with the process itself is stable.
    message : str
        One line for a person: what was done, what was chosen, or why it could not be.
    method : str
        As asked.
    controller : Fopid or None
        The design, or the nearest stable one when the specification cannot be met.
    achieved : Achieved or None
        What the loop with the process itself does.
    stable : bool
        Whether that loop is stable, decided by the argument principle.
    unstable_poles : int
        Number of unstable closed-loop poles.
    unmet : tuple of str
        Each specification that is not met, and how near one can come.
    cost : float
        What was minimised, at the design; nan for rules.
    evaluations : int
        Number of designs looked at.
    elapsed : float
        [s]
    at_edge : tuple of str
        Numbers that end on the edge of their range: a better design may lie beyond it.
    running : Running or None
        What the loop does as it runs: sampled, held, with the controller's filter bank. None without a stable design.
    filter, weights
        Of the measurement and of the setpoint: part of the design.
    structure : str
        Of the controller, where it was chosen by name or by preference.
    """

    success: bool
    message: str
    method: str
    controller: Fopid | None
    achieved: Achieved | None
    stable: bool
    unstable_poles: int
    unmet: tuple[str, ...]
    cost: float
    evaluations: int
    elapsed: float
    at_edge: tuple[str, ...] = ()
    running: Running | None = None
    filter: MeasurementFilter = NO_FILTER
    weights: SetpointWeights = WHOLE_SETPOINT
    structure: str = ""

    def __repr__(self) -> str:
        verdict = "success" if self.success else "no success"
        return f"<TuningResult: {verdict}, {self.controller or self.message}>"

    def _repr_html_(self) -> str:
        verdict: dict[str, object] = {"success": self.success, "message": self.message, "stable": self.stable}
        told = verdict | ({"unmet": "; ".join(self.unmet)} if self.unmet else {})
        parts = (self.controller, self.achieved)
        return "".join([*(part._repr_html_() for part in parts if part), notebook.table("Tuning", told)])


@dataclass(frozen=True)
class Proposal:
    """What a method proposes, before it is verified on the process itself.

    Attributes
    ----------
    controller : Fopid or None
    unmet : tuple of str
        Specifications it does not meet, and how near one can come.
    message : str
        What was done and what was chosen.
    cost : float
        What was minimised.
    evaluations : int
        Number of designs looked at.
    bounds : Bounds
        What the design must keep on the process itself.
    at_edge : tuple of str
        Numbers that end on the edge of their range.
    filter, weights
        Of the measurement and of the setpoint.
    structure : str
        Where it was chosen by name or by preference.
    """

    controller: Fopid | None
    unmet: tuple[str, ...]
    message: str
    cost: float
    evaluations: int
    bounds: Bounds = field(default_factory=Bounds)
    at_edge: tuple[str, ...] = ()
    filter: MeasurementFilter = NO_FILTER
    weights: SetpointWeights = WHOLE_SETPOINT
    structure: str = ""


def require(holds: bool, name: str, value: object, allowed: str) -> None:
    """Raise an InputError that names the input, its value and what is allowed, unless ``holds``."""
    if not holds:
        raise InputError(f"{name} = {value}; allowed: {allowed}")


def one_of(name: str, value: str, allowed: tuple[str, ...]) -> None:
    """Raise an InputError unless ``value`` is one of the words allowed."""
    near = did_you_mean(value, allowed) if isinstance(value, str) else ""
    require(value in allowed, name, repr(value), (", ".join(allowed) or "none for this method") + near)


def _require_practical(name: str, value: float | None, unit: str) -> None:
    """Times and frequencies that are not too far from 1 to compute with."""
    if value is not None:
        low, high = PRACTICAL
        require(low <= value <= high, name, value, f"{low:g} to {high:g} {unit}")


def _require_angle(phase_margin: float) -> None:
    allowed = "above 0 and below pi rad"
    if math.pi <= phase_margin < 180.0:
        allowed += f" ({phase_margin:g} degrees are {math.radians(phase_margin):.4g} rad, phase_margin_deg in Python)"
    require(0 < phase_margin < math.pi, "phase_margin", phase_margin, allowed)
