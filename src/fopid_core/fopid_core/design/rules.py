"""Published tuning rules: five numbers at once from the model K e^(-L s) / (T s + 1), each within its range.

Every rule was checked against what its authors promise, the margins or the largest sensitivity over its range (see the
tests). A rule refuses a process outside its range, and says what the range is.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fopid_core.design.defaults import PHASE_MARGIN, natural_crossover
from fopid_core.design.reduction import reduce
from fopid_core.design.specification import Expired, Progress, Proposal, TuningRequest, one_of
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process
from fopid_core.model.stability import stability

BY_DEFAULT = ("padula-visioli-setpoint-1.4", "simc-pi", "amigo-pi")
"""The first that holds the process: a derivative of order 1 or more holds none of one lag and a delay."""


@dataclass(frozen=True)
class Foptd:
    """The model a rule reads: K e^(-L s) / (T s + 1), times in seconds.

    Examples
    --------
    >>> Foptd(gain=2.0, lag=3.0, delay=1.0).relative_delay
    0.25
    """

    gain: float
    lag: float
    delay: float

    @property
    def relative_delay(self) -> float:
        """L / (L + T), between 0 and 1."""
        return self.delay / (self.delay + self.lag)


@dataclass(frozen=True)
class Rule:
    """A tuning rule.

    Attributes
    ----------
    name : str
        What people type.
    source : str
        Where it was published.
    valid : str
        Its range, in words.
    """

    name: str
    source: str
    valid: str
    _holds: Callable[[Foptd], bool]
    _gains: Callable[[Foptd], Fopid]

    def controller(self, model: Foptd) -> Fopid | None:
        """The controller for a model, or None outside the rule's range."""
        return self._gains(model) if self._holds(model) else None


def propose_rule(request: TuningRequest, progress: Progress, expired: Expired) -> Proposal:
    """The controller that a rule gives for a request's process."""
    del expired  # a rule takes no time
    name = request.rule or BY_DEFAULT[0]
    one_of("rule", name, (*RULES, DOMINANT_POLES))
    if name == DOMINANT_POLES:
        return _place_poles(request)
    progress(0.2, "reducing to foptd")
    model = foptd_of(request.process)
    if request.rule is None:
        name = next((each for each in BY_DEFAULT if _holds(request.process, RULES[each].controller(model))), name)
    rule = RULES[name]
    controller = rule.controller(model)
    read = f"read off K = {model.gain:.4g}, T = {model.lag:.4g} s, L = {model.delay:.4g} s"
    unmet = (
        () if controller else (f"rule {name}: {read}, L/(L+T) = {model.relative_delay:.3g}; valid for {rule.valid}",)
    )
    chosen = "" if request.rule else f"rule {name} by default; "
    return Proposal(controller, unmet, f"{chosen}{rule.source}, {read}", math.nan, 1)


def _holds(process: Process, controller: Fopid | None) -> bool:
    return controller is not None and stability(Loop(process, controller)).stable is True


def foptd_of(process: Process) -> Foptd:
    """The first-order model of a process, with its steady-state gain.

    Raises
    ------
    InputError
        If the process has no H2 norm and so no nearest model.
    """
    numbers = reduce(process, "foptd", keep_gain=True).parameters
    return Foptd(numbers["K"], numbers["T"], numbers["L"])


# Rows: 1, L, T, L^2, T^2, L T; columns: P, I, lambda, D, mu.
_VALERIO_FAST = np.array(
    [
        [-0.0048, 0.3254, 1.5766, 0.0662, 0.8736],
        [0.2664, 0.2478, -0.2098, -0.2528, 0.2746],
        [0.4982, 0.1429, -0.1313, 0.1081, 0.1489],
        [0.0232, -0.1330, 0.0713, 0.0702, -0.1557],
        [-0.0720, 0.0258, 0.0016, 0.0328, -0.0250],
        [-0.0348, -0.0171, 0.0114, 0.2202, -0.0323],
    ]
)
_VALERIO_SLOW = np.array(
    [
        [2.1187, -0.5201, 1.0645, 1.1421, 1.2902],
        [-3.5207, 2.6643, -0.3268, -1.3707, -0.5371],
        [-0.1563, 0.3453, -0.0229, 0.0357, -0.0381],
        [1.5827, -1.0944, 0.2018, 0.5552, 0.2208],
        [0.0025, 0.0002, 0.0003, -0.0002, 0.0007],
        [0.1824, -0.1054, 0.0028, 0.2630, -0.0014],
    ]
)


def _valerio(model: Foptd) -> Fopid:
    """Crossover 0.5 rad/s and phase margin 2/3 rad, by quadratic fits in L and T."""
    delay, lag = model.delay, model.lag
    table = _VALERIO_FAST if lag <= 5.0 else _VALERIO_SLOW
    p, i, lam, d, mu = np.array([1.0, delay, lag, delay**2, lag**2, delay * lag]) @ table
    return Fopid(p / model.gain, i / model.gain, d / model.gain, lam, mu)


def _fmigo(model: Foptd) -> Fopid:
    """Fractional PI: the largest integral gain under a bound on the maximum sensitivity, fitted in L / (L + T)."""
    tau = model.relative_delay
    lam = 1.1 if tau >= 0.6 else 1.0 if tau >= 0.4 else 0.9
    kp = 0.2978 / (model.gain * (tau + 0.00307))
    ki = kp * (tau**2 - 3.402 * tau + 2.405) / (0.8578 * model.lag)
    return Fopid(kp, ki, 0.0, lam, 1.0)


@dataclass(frozen=True)
class _PadulaVisioli:
    """Least IAE under max |S|, fitted as a x^b + c: kp in L / (L + T), integral and derivative time in L / T."""

    proportional: tuple[float, float, float]
    integral: tuple[float, float, float]
    derivative: tuple[float, float, float]
    orders: tuple[float, float, float]
    """mu for L / (L + T) below 0.1, below 0.4, and above."""

    def __call__(self, model: Foptd) -> Fopid:
        tau, ratio = model.relative_delay, model.delay / model.lag
        mu = self.orders[0] if tau < 0.1 else self.orders[1] if tau < 0.4 else self.orders[2]
        kp, ti, td = (
            a * x**b + c
            for (a, b, c), x in ((self.proportional, tau), (self.integral, ratio), (self.derivative, ratio))
        )
        return _parallel(kp / model.gain, ti * model.lag, td * model.lag**mu, mu, model)


def _parallel(kp: float, ti: float, td: float, mu: float, model: Foptd) -> Fopid:
    """The five numbers nearest to the series form kp (1 + 1/(ti s)) (1 + td s^mu) of the rule.

    The product has a term in s^(mu - 1) that the five numbers have not; at mu = 1 it is part of kp. Nearest means
    least squares of the relative error over the two decades around the corner 1/L.
    """
    s = 1j * np.logspace(-1.5, 0.5, 60) / model.delay
    series = kp * (1.0 + 1.0 / (ti * s)) * (1.0 + td * s**mu)
    columns = np.stack([np.ones_like(s), 1.0 / s, s**mu], axis=1) / series[:, None]
    system = np.concatenate([columns.real, columns.imag])
    target = np.concatenate([np.ones(len(s)), np.zeros(len(s))])
    p, i, d = np.linalg.lstsq(system, target, rcond=None)[0]
    return Fopid(float(p), float(i), float(d), 1.0, mu)


def simc_pi(model: Foptd, slower: float = 1.0) -> Fopid:
    """PI with a closed-loop time constant of so many delays, by the rule one."""
    speed = (1.0 + slower) * model.delay
    kp = model.lag / (model.gain * speed)
    return Fopid(kp, kp / min(model.lag, 4.0 * speed))


def _amigo_pi(model: Foptd) -> Fopid:
    gain, lag, delay = model.gain, model.lag, model.delay
    kp = 0.15 / gain + (0.35 - delay * lag / (delay + lag) ** 2) * lag / (gain * delay)
    ti = 0.35 * delay + 13.0 * delay * lag**2 / (lag**2 + 12.0 * delay * lag + 7.0 * delay**2)
    return Fopid(kp, kp / ti)


def _amigo_pid(model: Foptd) -> Fopid:
    gain, lag, delay = model.gain, model.lag, model.delay
    kp = (0.2 + 0.45 * lag / delay) / gain
    ti = (0.4 * delay + 0.8 * lag) / (delay + 0.1 * lag) * delay
    td = 0.5 * delay * lag / (0.3 * delay + lag)
    return Fopid(kp, kp / ti, kp * td)


def _has_delay(model: Foptd) -> bool:
    return model.delay > 1e-3 * model.lag


def _is_within_padula_visioli(model: Foptd) -> bool:
    return 0.05 <= model.relative_delay <= 0.8


_PADULA_VISIOLI = "Padula and Visioli, J. Process Control 21 (2011) 69-81"
_PADULA_VISIOLI_VALID = "0.05 <= L/(L+T) <= 0.8"
_DELAYED = "L > 0.001 T"

_ALL_RULES = (
    Rule(
        "valerio-1",
        "Valerio and Sa da Costa, Signal Processing 86 (2006) 2771-2784, first set of rules",
        "0.1 s <= T <= 50 s and 0 < L <= 2 s",
        lambda model: 0.1 <= model.lag <= 50.0 and 0.0 < model.delay <= 2.0,
        _valerio,
    ),
    Rule(
        "fmigo",
        "Chen, Bhaskaran and Xue, ASME J. Comput. Nonlinear Dynam. 3 (2008) 021403 (F-MIGO)",
        "L/(L+T) >= 0.1",
        lambda model: model.relative_delay >= 0.1,
        _fmigo,
    ),
    Rule(
        "padula-visioli-setpoint-1.4",
        f"{_PADULA_VISIOLI}, setpoint, Ms = 1.4",
        _PADULA_VISIOLI_VALID,
        _is_within_padula_visioli,
        _PadulaVisioli(
            (0.6503, -0.9166, -0.6741), (0.04701, -0.2611, 0.9276), (0.3563, 1.2, 0.0003108), (1.1, 1.2, 1.2)
        ),
    ),
    Rule(
        "padula-visioli-setpoint-2.0",
        f"{_PADULA_VISIOLI}, setpoint, Ms = 2.0",
        _PADULA_VISIOLI_VALID,
        _is_within_padula_visioli,
        _PadulaVisioli(
            (0.9294, -0.933, -0.9205), (-0.001427, -1.003, 1.031), (0.4203, 1.229, 0.01822), (1.0, 1.1, 1.2)
        ),
    ),
    Rule(
        "padula-visioli-load-1.4",
        f"{_PADULA_VISIOLI}, load, Ms = 1.4",
        _PADULA_VISIOLI_VALID,
        _is_within_padula_visioli,
        _PadulaVisioli(
            (0.2776, -1.095, -0.1426), (0.6241, 0.5573, 0.0442), (0.4793, 0.7469, -0.02393), (1.0, 1.1, 1.2)
        ),
    ),
    Rule(
        "padula-visioli-load-2.0",
        f"{_PADULA_VISIOLI}, load, Ms = 2.0",
        _PADULA_VISIOLI_VALID,
        _is_within_padula_visioli,
        _PadulaVisioli((0.1804, -1.449, 0.2319), (0.6426, 0.8069, 0.05627), (0.597, 0.5568, -0.09536), (1.0, 1.1, 1.2)),
    ),
    Rule("simc-pi", "Skogestad, J. Process Control 13 (2003) 291-309 (SIMC)", _DELAYED, _has_delay, simc_pi),
    Rule("amigo-pi", "Astrom and Hagglund, Advanced PID Control (2006) (AMIGO)", _DELAYED, _has_delay, _amigo_pi),
    Rule("amigo-pid", "Astrom and Hagglund, Advanced PID Control (2006) (AMIGO)", _DELAYED, _has_delay, _amigo_pid),
)
RULES = {rule.name: rule for rule in _ALL_RULES}
"""The rules by name."""

DOMINANT_POLES = "dominant-poles"
"""Placement of all three closed-loop poles of a second-order process, where dominance is certain."""
_DAMPING = math.sqrt(0.5)
_THIRD_POLE = 5.0  # so many times further left than the dominant pair


def _place_poles(request: TuningRequest) -> Proposal:
    """PID that places a dominant pair and one fast pole, for K / (a2 s^2 + a1 s + a0) only.

    As the paper says, for any higher order or a delay the rest of the poles is left to chance, so that is refused.
    """
    process = request.process
    valid = "valid for processes of second order without zeros and delay"
    if not process.is_rational or process.delay or process.denominator.degree != 2 or process.numerator.degree != 0:
        return Proposal(None, (f"rule {DOMINANT_POLES}: process {process}; {valid}",), "no rule applies", math.nan, 0)
    numerator, denominator, _ = process.polynomials()
    a2, a1, a0 = denominator
    gain = numerator[-1]
    speed = request.crossover or natural_crossover(process, PHASE_MARGIN)
    pair = 2.0 * _DAMPING * speed
    third = _THIRD_POLE * _DAMPING * speed
    # (s^2 + 2 zeta w s + w^2) (s + p) = s^3 + (a1 + K kd)/a2 s^2 + (a0 + K kp)/a2 s + K ki / a2
    controller = Fopid(
        kp=(a2 * (speed**2 + pair * third) - a0) / gain,
        ki=a2 * speed**2 * third / gain,
        kd=(a2 * (pair + third) - a1) / gain,
    )
    message = f"poles of damping {_DAMPING:.3f} and natural frequency {speed:.4g} rad/s, third pole at -{third:.4g}"
    return Proposal(controller, (), message, math.nan, 1)


def rule_names() -> tuple[str, ...]:
    """Every rule there is."""
    return (*RULES, DOMINANT_POLES)
