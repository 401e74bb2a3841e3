"""Model structures that can be learnt: what is linear in them, what is not, and which process their numbers make.

Every structure is ``(g_0 + g_1 s + ...) exp(-L s)`` over a product of sections
``(tau s)^alpha + c (tau s)^beta + 1``, or ``tau s - 1`` first. The g are linear; log tau, log c, alpha, beta of each
section and L are not.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fopid_core.errors import InputError
from fopid_core.model.arrays import Complexes, Floats
from fopid_core.model.process import Process
from fopid_core.model.quasipolynomial import QuasiPolynomial
from fopid_core.model.templates import TEMPLATES

MOST_ORDER = 6
_LOG_C = (math.log(0.01), math.log(100.0))
_ALPHA, _BETA = (0.4, 3.0), (0.1, 2.0)
_ONE_ALPHA = (0.4, 1.95)
"""Orders that are looked at; with one power of s alone, 2 is the border of stability."""
_LONGEST, _LONGEST_ALONE = 30.0, 1000.0
"""In records: with 30 a lag with delay is no integrator, for it ends by a thirtieth within one. Among several lags one
so long would stand for anything slow, also for an actuator that sticks."""
_FASTEST_RUNAWAY = 2.0
"""A process does not run away by a factor of e in fewer samples than this."""
LONGEST_NAME = 80
"""Characters of a name that is not known, in a message."""
_RATIONAL = re.compile(r"rational:(\d{1,4})(?:/(\d{1,4}))?")


@dataclass(frozen=True)
class Section:
    """``(tau s)^alpha + c (tau s)^beta + 1``; an order that is None is free, without ``damped`` there is no c.

    With ``end`` -1 in place of the 1 it runs away; with 0 it is ``s``, an integrator, and has no number.
    """

    alpha: float | None
    beta: float | None = None
    damped: bool = False
    end: float = 1.0

    @property
    def names(self) -> tuple[str, ...]:
        """Its free numbers."""
        free = (self.end != 0.0, self.damped, self.alpha is None, self.damped and self.beta is None)
        return tuple(n for n, is_free in zip(("log_tau", "log_c", "alpha", "beta"), free, strict=True) if is_free)

    def numbers(self, x: Floats) -> tuple[float, float, float, float]:
        """Log tau, log c, alpha and beta, from the free ones."""
        given = dict(zip(self.names, x.tolist(), strict=True))
        return (
            given.get("log_tau", 0.0),
            given.get("log_c", -math.inf),
            given.get("alpha", self.alpha or 0.0),
            given.get("beta", self.beta or 0.0),
        )

    def logarithm(self, x: Floats, log_s: Complexes) -> tuple[Complexes, list[Complexes]]:
        """The section's value at s, and the derivatives of its logarithm with respect to the free numbers."""
        log_tau, log_c, alpha, beta = self.numbers(x)
        z: Complexes = log_s + log_tau
        first: Complexes = np.exp(alpha * z)
        second: Complexes = np.exp(beta * z + log_c) if self.damped else np.zeros_like(first)
        value = first + second + self.end
        slopes = {"log_tau": alpha * first + beta * second, "log_c": second, "alpha": first * z, "beta": second * z}
        return value, [slopes[name] / value for name in self.names]


LAG = Section(alpha=1.0)
FRACTIONAL_LAG = Section(alpha=None)
PAIR = Section(alpha=2.0, beta=1.0, damped=True)
RUNAWAY = Section(alpha=1.0, end=-1.0)
INTEGRATOR = Section(alpha=1.0, end=0.0)


@dataclass(frozen=True)
class Structure:
    """A model structure: name, sections of the denominator, and order of the numerator.

    Examples
    --------
    >>> structure = structure_of("soptd")
    >>> structure.free
    ('log_tau', 'log_c', 'L')
    >>> str(structure.process(np.array([0.0, np.log(2.0), 0.5]), np.array([3.0])))
    '3/(s^2 + 2 s + 1) * exp(-0.5s)'
    """

    name: str
    sections: tuple[Section, ...]
    zeros: int = 0

    @property
    def runs_away(self) -> bool:
        """Whether it has an unstable pole, the first number's."""
        return self.sections[0].end < 0.0

    @cached_property
    def free(self) -> tuple[str, ...]:
        """The numbers that are not linear, in order; the delay is the last."""
        return (*(name for section in self.sections for name in section.names), "L")

    @cached_property
    def _places(self) -> list[slice]:
        ends = np.cumsum([len(section.names) for section in self.sections]).tolist()
        return [slice(end - len(section.names), end) for section, end in zip(self.sections, ends, strict=True)]

    def denominator(self, x: Floats, log_s: Complexes) -> tuple[Complexes, list[Complexes]]:
        """Its value at s and the derivatives of its logarithm with respect to all but the delay."""
        parts = [section.logarithm(x[place], log_s) for section, place in zip(self.sections, self._places, strict=True)]
        value = parts[0][0]
        for other, _ in parts[1:]:
            value = value * other
        return value, [slope for _, slopes in parts for slope in slopes]

    def fast_end(self, x: Floats) -> tuple[float, float, float]:
        """Order, logarithm of the leading coefficient, and a rate [1/s] of the denominator at high frequency."""
        order = log_lead = log_rate = 0.0
        for section, place in zip(self.sections, self._places, strict=True):
            log_tau, _, alpha, _ = section.numbers(x[place])
            order, log_lead = order + alpha, log_lead + alpha * log_tau
            log_rate = max(log_rate, -log_tau) if section.end else log_rate
        return order, log_lead, math.exp(log_rate)

    def bounds(self, sample_time: float, span: float) -> tuple[Floats, Floats]:
        """Where the free numbers are sought for a record of this sample time and span [s]."""
        alone = [name == "alpha" and "beta" not in self.free for name in self.free]
        longest = _LONGEST_ALONE if self.sections in ((LAG,), (FRACTIONAL_LAG,)) else _LONGEST
        ranges = {
            "log_tau": (math.log(0.2 * sample_time), math.log(longest * span)),
            "log_c": _LOG_C,
            "alpha": _ALPHA,
            "beta": _BETA,
            "L": (0.0, 0.6 * span),
        }
        pairs = [_ONE_ALPHA if one else ranges[name] for name, one in zip(self.free, alone, strict=True)]
        low, high = np.array(pairs).T
        if self.runs_away:
            low[0] = math.log(_FASTEST_RUNAWAY * sample_time)
        return low, high

    def parameters(self, x: Floats, gains: Floats) -> dict[str, float]:
        """The numbers by the names that people know: of the template, or coefficients b0 ... and a1 ... of powers."""
        delay = float(x[-1])
        if self.name not in TEMPLATES:
            numerator = {f"b{j}": float(g) for j, g in enumerate(gains)}
            denominator = self._polynomial(x)[::-1]
            return numerator | {f"a{j}": float(a) for j, a in enumerate(denominator) if j} | {"L": delay}
        section, gain = self.sections[0], float(gains[0])
        log_tau, log_c, alpha, beta = section.numbers(x[:-1])
        orders = {n: v for n, v in (("alpha", alpha), ("beta", beta)) if n in self.free}
        if not section.damped:
            return {"K": gain, "T": math.exp(alpha * log_tau), **orders, "L": delay}
        a0, a1 = math.exp(-alpha * log_tau), math.exp(log_c + (beta - alpha) * log_tau)
        return {"K": gain * a0, "a1": a1, "a0": a0, **orders, "L": delay}

    def process_of(self, parameters: Mapping[str, float]) -> Process:
        """The process with these parameters."""
        if self.name in TEMPLATES:
            return TEMPLATES[self.name].process(parameters)
        numerator = [parameters[f"b{j}"] for j in range(self.zeros, -1, -1)]
        order = sum(name.startswith("a") for name in parameters)
        end = math.prod(section.end for section in self.sections)
        denominator = [*(parameters[f"a{j}"] for j in range(order, 0, -1)), end]
        delayed = QuasiPolynomial.polynomial(numerator).shifted(delay=parameters["L"])
        return Process(delayed, QuasiPolynomial.polynomial(denominator))

    def process(self, x: Floats, gains: Floats) -> Process:
        """The process with these numbers."""
        return self.process_of(self.parameters(x, gains))

    def _polynomial(self, x: Floats) -> Floats:
        coefficients = np.ones(1)
        for section, place in zip(self.sections, self._places, strict=True):
            log_tau, log_c, _, _ = section.numbers(x[place])
            tau = math.exp(log_tau)
            factor = [tau**2, math.exp(log_c) * tau, 1.0] if section.damped else [tau, section.end]
            coefficients = np.convolve(coefficients, factor)
        return coefficients


TEMPLATE_STRUCTURES = {
    "foptd": Structure("foptd", (LAG,)),
    "nioptd1": Structure("nioptd1", (FRACTIONAL_LAG,)),
    "soptd": Structure("soptd", (PAIR,)),
    "nioptd2": Structure("nioptd2", (Section(alpha=None, beta=None, damped=True),)),
}
UNSTABLE_STRUCTURES = {
    "unstable:1": Structure("unstable:1", (RUNAWAY,)),
    "unstable:2i": Structure("unstable:2i", (RUNAWAY, INTEGRATOR)),
    "unstable:2": Structure("unstable:2", (RUNAWAY, LAG)),
    "unstable:2/1": Structure("unstable:2/1", (RUNAWAY, LAG), 1),
    "unstable:3": Structure("unstable:3", (RUNAWAY, PAIR)),
}
"""One pole on the right: alone, beside an integrator, a lag, a lag and a zero, two lags."""


def structure_of(name: str) -> Structure:
    """A template by its name, or ``rational:N/M``: denominator of order N, numerator of order M (0 when not given).

    ``unstable:N`` has one unstable pole among its N, ``unstable:2i`` an integrator as well, ``unstable:2/1`` a zero.

    Examples
    --------
    >>> structure_of("rational:3/1").free
    ('log_tau', 'log_c', 'log_tau', 'L')
    """
    if name in TEMPLATE_STRUCTURES:
        return TEMPLATE_STRUCTURES[name]
    if name in UNSTABLE_STRUCTURES:
        return UNSTABLE_STRUCTURES[name]
    known = ", ".join((*TEMPLATE_STRUCTURES, *UNSTABLE_STRUCTURES))
    allowed = f"{known}, rational:N or rational:N/M with M < N <= {MOST_ORDER}"
    match = _RATIONAL.fullmatch(name)
    order, zeros = (int(match[1]), int(match[2] or 0)) if match else (0, 0)
    if not zeros < order <= MOST_ORDER:
        raise InputError(f"template {name[:LONGEST_NAME]!r}; allowed: {allowed}")
    return Structure(name, (PAIR,) * (order // 2) + (LAG,) * (order % 2), zeros)
