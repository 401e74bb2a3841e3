"""The bridge to python-control: fractional powers by Oustaloup's filter, delays by Pade's fraction, and back.

For people who want a ``TransferFunction`` or a ``StateSpace``. Nothing in this package computes with these
approximations: they say nothing certain about the loop.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from fopid_core.errors import InputError
from fopid_core.model.arrays import Floats
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process
from fopid_core.model.quasipolynomial import QuasiPolynomial

if TYPE_CHECKING:
    import control

_HIGHEST_ORDER = 20


@dataclass(frozen=True)
class Approximation:
    """How to make a model rational.

    Attributes
    ----------
    order : int
        N of Oustaloup's filter, which has 2 N + 1 poles and zeros.
    band : tuple of float
        Frequencies [rad/s] between which the filter holds.
    pade_order : int
        Order of the Pade fraction of a delay.
    """

    order: int = 5
    band: tuple[float, float] = (1e-3, 1e3)
    pade_order: int = 5

    def __post_init__(self) -> None:
        for name in ("order", "pade_order"):
            if not 1 <= getattr(self, name) <= _HIGHEST_ORDER:
                raise InputError(f"{name} = {getattr(self, name)}; allowed: 1 to {_HIGHEST_ORDER}")
        low, high = self.band
        if not 0.0 < low < high < math.inf:
            raise InputError(f"band = {self.band}; allowed: two rising positive frequencies [rad/s]")


@dataclass(frozen=True)
class _Factors:
    """A rational function by its zeros, poles and gain."""

    zeros: Floats
    poles: Floats
    gain: float


def oustaloup(power: float, approximation: Approximation | None = None) -> control.TransferFunction:
    """A rational function close to ``s**power`` on a band.

    Whole powers stay exact; of a fractional one the whole part is taken out downward, so that ``s**-0.3`` keeps its
    integrator: ``s**0.7 / s``. Oustaloup et al. (2000), eq. (27).

    Parameters
    ----------
    power : float
        Any real number.
    approximation : Approximation, optional

    Examples
    --------
    >>> approximated = complex(oustaloup(0.5)(1j))
    >>> abs(approximated / 1j**0.5 - 1) < 0.01
    True
    """
    import control

    factors = _power(power, approximation or Approximation())
    return control.zpk(factors.zeros, factors.poles, factors.gain)


def _power(power: float, approximation: Approximation) -> _Factors:
    """``s**power``, its fractional part as ``high**fraction`` times lead-lag sections spread evenly over the band."""
    whole = math.floor(power)
    fraction = power - whole
    origin = np.zeros(abs(whole))
    zeros, poles = (origin, origin[:0]) if whole >= 0 else (origin[:0], origin)
    if fraction == 0.0:
        return _Factors(zeros, poles, 1.0)
    low, high = approximation.band
    sections = 2 * approximation.order + 1
    place = (np.arange(sections) + 0.5) / sections
    shift = 0.5 * fraction / sections
    lows = -low * (high / low) ** (place - shift)
    highs = -low * (high / low) ** (place + shift)
    return _Factors(np.append(zeros, lows), np.append(poles, highs), high**fraction)


def to_transfer_function(
    model: Process | Fopid, approximation: Approximation | None = None
) -> control.TransferFunction:
    """A process or a controller as a python-control transfer function.

    Whole powers of s are exact; fractional powers and delays are approximated. Polynomials of the high degree that two
    fractional powers already make are good for a frequency response, not for closing a loop: ``to_state_space`` is.

    Parameters
    ----------
    model : Process or Fopid
    approximation : Approximation, optional
        Used only where there is something to approximate.

    Examples
    --------
    >>> process = Process.parse("2/(s+1)*exp(-0.1s)")
    >>> abs(complex(to_transfer_function(process)(1j)) - complex(process(1j))) < 1e-9
    True
    """
    approximation = approximation or Approximation()
    if isinstance(model, Fopid):
        return _quotient(model.numerator, QuasiPolynomial.monomial(1.0, order=model.integral_order), approximation)
    return _quotient(model.numerator, model.denominator, approximation)


def _quotient(
    numerator: QuasiPolynomial, denominator: QuasiPolynomial, approximation: Approximation
) -> control.TransferFunction:
    """Both over the same factors of fractional powers and delays, which then cancel."""
    import control

    fractions = sorted({t.order - math.floor(t.order) for part in (numerator, denominator) for t in part.terms} - {0.0})
    delays = sorted({t.delay for part in (numerator, denominator) for t in part.terms} - {0.0})
    parts = {key: _fraction(key, approximation) for key in fractions} | {
        -key: _pade(key, approximation) for key in delays
    }

    def polynomial(function: QuasiPolynomial) -> Floats:
        total = np.zeros(1)
        for term in function.terms:
            whole = math.floor(term.order)
            product = term.coefficient * np.append(1.0, np.zeros(whole))
            for key, (over, under) in parts.items():
                factor = over if key in (term.order - whole, -term.delay) else under
                product = np.asarray(np.polymul(product, factor), dtype=np.float64)
            total = np.asarray(np.polyadd(total, product), dtype=np.float64)
        return total

    return control.TransferFunction(polynomial(numerator), polynomial(denominator))


def _fraction(power: float, approximation: Approximation) -> tuple[Floats, Floats]:
    factors = _power(power, approximation)
    over, under = factors.gain * np.poly(factors.zeros), np.poly(factors.poles)
    return np.asarray(over, dtype=np.float64), np.asarray(under, dtype=np.float64)


def _pade(delay: float, approximation: Approximation) -> tuple[Floats, Floats]:
    import control

    over, under = control.pade(delay, approximation.pade_order)
    return np.asarray(over, dtype=np.float64), np.asarray(under, dtype=np.float64)


def to_state_space(model: Process | Fopid, approximation: Approximation | None = None) -> control.StateSpace:
    """A process or a controller as a python-control state space, well scaled whatever the number of states.

    Every fractional power is a bank of first-order lags of its own; nothing is multiplied out.

    Parameters
    ----------
    model : Process or Fopid
        A process may have one delay, a controller a derivative of an order below 1.
    approximation : Approximation, optional

    Examples
    --------
    >>> process = Process.parse("1/(s^1.5+1)")
    >>> abs(complex(to_state_space(process)(1j)) - complex(process(1j))) < 0.01
    True
    """
    approximation = approximation or Approximation()
    if isinstance(model, Fopid):
        return _controller_space(model, approximation)
    if not (model.numerator.has_one_delay and model.denominator.has_one_delay):
        raise InputError(f"process {model} has several delays; allowed here: one delay of the whole process")
    space = _process_space(model.without_delay(), approximation)
    return space * _pade_space(model.delay, approximation) if model.delay else space


def _controller_space(controller: Fopid, approximation: Approximation) -> control.StateSpace:
    if controller.kd and controller.mu >= 1.0:
        raise InputError(f"mu = {controller.mu:g}; allowed here: below 1, or kd = 0 (a state space is proper)")
    kp, ki, kd, lam, mu = controller.gains
    parts = [(ki, -lam), (kd, mu)]
    return sum((gain * _power_space(power, approximation) for gain, power in parts if gain), _static(kp))


def _process_space(process: Process, approximation: Approximation) -> control.StateSpace:
    """One block ``s**(q - n)`` for every order q of a process of order n, all fed by the input and the output."""
    import control

    top = process.denominator.degree
    over = {t.order: t.coefficient for t in process.numerator.terms}
    under = {t.order: t.coefficient for t in process.denominator.terms}
    lead = under.pop(top)
    orders = sorted(over.keys() | under.keys())
    blocks = control.append(*(_power_space(order - top, approximation) for order in orders))
    n = np.array([[over.get(order, 0.0) / lead] for order in orders])
    d = np.array([[under.get(order, 0.0) / lead] for order in orders])
    output, direct = blocks.C.sum(axis=0, keepdims=True), blocks.D.sum(axis=0, keepdims=True)
    loop = 1.0 / (1.0 + (direct @ d).item())
    return control.ss(
        blocks.A - loop * blocks.B @ d @ output,
        blocks.B @ (n - loop * d @ direct @ n),
        loop * output,
        loop * direct @ n,
    )


def _power_space(power: float, approximation: Approximation) -> control.StateSpace:
    """A power of s below 1: lags side by side, integrators in a row."""
    import control

    whole = math.floor(power)
    space = _static(1.0)
    if power != whole:
        factors = _power(power - whole, approximation)
        distances = factors.poles[:, None] - factors.poles + np.eye(factors.poles.size)
        residues = factors.gain * np.prod((factors.poles[:, None] - factors.zeros) / distances, axis=1)
        space = control.ss(np.diag(factors.poles), np.ones((residues.size, 1)), residues[None, :], factors.gain)
    for _ in range(-whole):
        space = space * control.ss([[0.0]], [[1.0]], [[1.0]], [[0.0]])
    return space


def _pade_space(delay: float, approximation: Approximation) -> control.StateSpace:
    import control

    return control.ss(control.TransferFunction(*control.pade(delay, approximation.pade_order)))


def _static(gain: float) -> control.StateSpace:
    import control

    return control.ss([], [], [], [[gain]])


def from_control(system: control.TransferFunction | control.StateSpace, delay: float = 0.0) -> Process:
    """A process from a python-control object with one input and one output in continuous time.

    Parameters
    ----------
    system : TransferFunction or StateSpace
    delay : float
        A delay [s] behind it, which python-control objects cannot hold.

    Examples
    --------
    >>> import control
    >>> str(from_control(control.tf([1], [1, 2, 1]), delay=0.5))
    '1/(s^2 + 2 s + 1) * exp(-0.5s)'
    """
    import control

    if not isinstance(system, control.TransferFunction | control.StateSpace):
        raise InputError(f"system of type {type(system).__name__}; allowed: TransferFunction, StateSpace")
    if system.ninputs != 1 or system.noutputs != 1:
        raise InputError(
            f"system with {system.ninputs} inputs and {system.noutputs} outputs; allowed: one input and one output"
        )
    if system.isdtime(strict=True):
        raise InputError(f"system with the sample time {system.dt} s; allowed: continuous time")
    numerator, denominator = _polynomials(system)
    return Process(QuasiPolynomial.polynomial(numerator), QuasiPolynomial.polynomial(denominator)).delayed(delay)


def _polynomials(system: control.TransferFunction | control.StateSpace) -> tuple[Floats, Floats]:
    import control

    if isinstance(system, control.TransferFunction):
        return system.num[0][0], system.den[0][0]
    zeros, poles = (np.atleast_1d(np.poly(r)).real for r in (control.zeros(system), control.poles(system)))
    point = 1.0 + 2.0 * float(np.max(np.abs(control.poles(system)), initial=0.0))  # to the right of every pole
    gain = complex(system(point)).real * np.polyval(poles, point) / np.polyval(zeros, point)
    return np.asarray(gain * zeros, dtype=np.float64), np.asarray(poles, dtype=np.float64)
