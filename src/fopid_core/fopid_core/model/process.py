"""The process: a proper transfer function in real powers of s, with exact delay."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, overload

import numpy as np
from numpy.typing import ArrayLike

from fopid_core import notebook, safe_yaml
from fopid_core.errors import ExpressionError, InputError, did_you_mean
from fopid_core.model.arrays import Complexes, Floats
from fopid_core.model.expression import read_quotient
from fopid_core.model.quasipolynomial import QuasiPolynomial, number_text

if TYPE_CHECKING:
    from fopid_core.model.fopid import Fopid
    from fopid_core.model.loop import Loop

TEST_BENCH = {
    "P1": "1/(s+1)^3",
    "P2": "9/((s+1)(s^2+2s+9))",
    "P3": "1/(s+1)^4",
    "P4": "1/((s+1)(0.2s+1)(0.04s+1)(0.008s+1))",
}
"""The paper's higher order test bench, eqs. (12) to (15)."""

COEFFICIENT_RANGE = (1e-100, 1e100)
"""Sizes of the numbers of a process: beyond them products are no numbers any more."""
DELAY_RANGE = (1e-12, 1e12)
"""Delays of a process [s], for the same reason."""


@dataclass(frozen=True)
class Process:
    """P(s) = numerator(s) / denominator(s), quasi-polynomials in s.

    Call it with complex s (any shape) to get P(s); delays and fractional powers are exact.
    ``Process.parse`` reads a text, ``read_process`` also takes the names P1 ... P4 and files.

    Attributes
    ----------
    numerator, denominator : QuasiPolynomial
        Normalised: no common power of s, the denominator's shortest delay is zero and its leading
        coefficient (of the undelayed highest power) as given.

    Examples
    --------
    >>> process = Process.parse("2/(s+1)*exp(-0.5s)")
    >>> process.delay, process.steady_state_gain
    (0.5, 2.0)
    >>> complex(process(0.0))
    (2+0j)
    """

    numerator: QuasiPolynomial
    denominator: QuasiPolynomial

    def __post_init__(self) -> None:
        if self.denominator.is_zero:
            raise InputError("process with the denominator 0; allowed: any other denominator")
        if self.numerator.is_zero:
            raise InputError("process with the numerator 0; allowed: a process that answers its input")
        shift = min(self.denominator.lowest_order, self.numerator.lowest_order)
        delay = self.denominator.lowest_delay
        if shift or delay:
            object.__setattr__(self, "numerator", self.numerator.shifted(-shift, -delay))
            object.__setattr__(self, "denominator", self.denominator.shifted(-shift, -delay))
        self._check_causal()

    def _check_causal(self) -> None:
        for part in (self.numerator, self.denominator):
            if any(not math.isfinite(x) for t in part.terms for x in (t.coefficient, t.order, t.delay)):
                raise InputError(f"process {self} has a number that is not finite; allowed: finite numbers")
            for t in part.terms:
                _check_size(self, "the coefficient", abs(t.coefficient), COEFFICIENT_RANGE)
                _check_size(self, "the delay", abs(t.delay), DELAY_RANGE)
        if self.numerator.lowest_delay < 0:
            raise InputError(f"process {self} looks into the future; allowed: delays >= 0")
        degree = self.denominator.degree
        for term in self.numerator.terms:
            if term.order > degree:
                raise InputError(
                    f"process {self} is not proper: numerator of order {term.order:g}, "
                    f"denominator of order {degree:g}; allowed: at most the denominator's order"
                )
        if all(t.delay > 0 for t in self.denominator.terms if t.order == degree):
            raise InputError(f"process {self} is of advanced type: the highest power of s is delayed")

    @staticmethod
    def parse(text: str) -> Process:
        """Read a transfer function such as ``"9/((s+1)(s^2+2s+9))*exp(-0.2s)"``.

        Raises
        ------
        ExpressionError
            If the text cannot be read; its message names the character.
        InputError
            If it reads as something that is not a proper, causal process.
        """
        quotient = read_quotient(text)
        try:
            return Process(quotient.numerator, quotient.denominator)
        except InputError as error:
            raise ExpressionError(text, 0, str(error)) from None

    def __call__(self, s: ArrayLike) -> Complexes:
        """P(s) at every element of ``s``."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return self.numerator(s) / self.denominator(s)

    def logarithmic_derivative(self, s: ArrayLike) -> Complexes:
        """P'(s) / P(s) at every element of ``s``; what phase slopes are made of."""
        return self.numerator.derivative(s) / self.numerator(s) - self.denominator.derivative(s) / self.denominator(s)

    @cached_property
    def delay(self) -> float:
        """The time before the output answers the input at all [s]."""
        return self.numerator.lowest_delay

    @property
    def relative_degree(self) -> float:
        """Order of the denominator less order of the numerator."""
        return self.denominator.degree - self.numerator.degree

    @property
    def integrating_order(self) -> float:
        """The power of 1/s in the process: 0 for a process that settles."""
        return self.denominator.lowest_order

    @property
    def is_rational(self) -> bool:
        """Whether it is a ratio of ordinary polynomials times one delay."""
        return self.has_integer_orders and self.numerator.has_one_delay and self.denominator.has_one_delay

    @property
    def has_integer_orders(self) -> bool:
        """Whether every power of s is a whole number."""
        return self.numerator.has_integer_orders and self.denominator.has_integer_orders

    @property
    def cancels_at_origin(self) -> bool:
        """Whether delayed terms cancel at s = 0 above and below, as in a moving average: (1 - exp(-Ts)) / (Ts)."""
        over, under = self.numerator, self.denominator
        return over.lowest_order == 0.0 == over.sum_of_order(0.0) == under.sum_of_order(0.0)

    @property
    def steady_state_gain(self) -> float:
        """P(0): infinite for an integrating process."""
        if self.integrating_order > 0:
            return math.inf
        return float(self(0.0).real)

    def polynomials(self) -> tuple[Floats, Floats, float]:
        """Numerator and denominator coefficients (highest power first) and the delay [s].

        Raises
        ------
        InputError
            If the process is not rational.
        """
        if not self.is_rational:
            raise InputError(f"process {self} is not rational; allowed here: whole powers of s and one delay")
        return self.numerator.coefficients(), self.denominator.coefficients(), self.delay

    def without_delay(self) -> Process:
        """The process with its delay taken out."""
        return Process(self.numerator.shifted(delay=-self.delay), self.denominator)

    def delayed(self, delay: float) -> Process:
        """The process behind a further ``delay`` [s]."""
        return Process(self.numerator.shifted(delay=delay), self.denominator)

    def scaled(self, gain: float) -> Process:
        """The process times a constant."""
        return Process(self.numerator.scaled(gain), self.denominator)

    @overload
    def __mul__(self, other: Process | float) -> Process: ...
    @overload
    def __mul__(self, other: Fopid) -> Loop: ...
    def __mul__(self, other: Process | float | Fopid) -> Process | Loop:
        """Series connection, or a gain; with a controller the loop of both."""
        if not isinstance(other, Process | float | int):
            return NotImplemented
        other = _process(other)
        return Process(self.numerator * other.numerator, self.denominator * other.denominator)

    def __rmul__(self, other: float) -> Process:
        return self * other

    def __truediv__(self, other: Process | float) -> Process:
        """By a gain, or by another process: the quotient must be proper and must not look into the future."""
        if isinstance(other, Process):
            return Process(self.numerator * other.denominator, self.denominator * other.numerator)
        return self.scaled(1.0 / other) if isinstance(other, float | int) else NotImplemented

    def __add__(self, other: Process | float) -> Process:
        """Parallel connection, or a direct path."""
        if not isinstance(other, Process | float | int):
            return NotImplemented
        other = _process(other)
        if self.denominator == other.denominator:
            return Process(self.numerator + other.numerator, self.denominator)
        cross = self.numerator * other.denominator + other.numerator * self.denominator
        return Process(cross, self.denominator * other.denominator)

    __radd__ = __add__

    def __neg__(self) -> Process:
        return self.scaled(-1.0)

    def __sub__(self, other: Process | float) -> Process:
        return self + -_process(other) if isinstance(other, Process | float | int) else NotImplemented

    def __rsub__(self, other: float) -> Process:
        return _process(other) - self

    def feedback(self, other: Process | float = 1.0) -> Process:
        """Negative feedback P / (1 + P H).

        Examples
        --------
        >>> str(Process.parse("1/s").feedback(2.0))
        '1/(s + 2)'
        """
        other = _process(other)
        return Process(
            self.numerator * other.denominator,
            self.denominator * other.denominator + self.numerator * other.numerator,
        )

    def __repr__(self) -> str:
        return f"Process.parse({str(self)!r})"

    def _repr_latex_(self) -> str:
        over = notebook.latex(str(self.numerator.shifted(delay=-self.delay)))
        late = rf"\,e^{{-{number_text(self.delay)}s}}" if self.delay else ""
        return rf"$\dfrac{{{over}}}{{{notebook.latex(str(self.denominator))}}}{late}$"

    def __str__(self) -> str:
        """The process as text that ``parse`` reads back."""
        delay = self.delay
        numerator = str(self.numerator.shifted(delay=-delay))
        if len(self.numerator.terms) > 1:
            numerator = f"({numerator})"
        body = numerator if str(self.denominator) == "1" else f"{numerator}/({self.denominator})"
        return f"{body} * exp({number_text(-delay)}s)" if delay else body


def _check_size(process: Process, name: str, size: float, allowed: tuple[float, float]) -> None:
    low, high = allowed
    if size and not low <= size <= high:
        raise InputError(f"process {process} has {name} {size:g}; allowed: 0 or {low:g} to {high:g} in size")


def _process(value: Process | float) -> Process:
    if isinstance(value, Process):
        return value
    return Process(QuasiPolynomial.constant(value), QuasiPolynomial.constant(1.0))


def read_process(source: str) -> Process:
    """A process from what people type: a name of the test bench, a text, or a YAML file.

    Parameters
    ----------
    source : str
        ``"P1"`` ... ``"P4"``, a transfer function in s, or the path of a file that ends in ``.yaml``
        or ``.yml`` and holds the key ``process`` with one of the former.

    Examples
    --------
    >>> str(read_process("P1"))
    '1/(s^3 + 3 s^2 + 3 s + 1)'
    """
    name = source.strip()
    if name.endswith((".yaml", ".yml")):
        return _read_process_file(Path(name))
    if name[:1] in ("P", "p") and name[1:].isdecimal() and name not in TEST_BENCH:
        known = f"{', '.join(TEST_BENCH)}, a transfer function in s, or a YAML file"
        raise InputError(f"process {name!r}; allowed: {known}{did_you_mean(name, TEST_BENCH)}")
    return Process.parse(TEST_BENCH.get(name, source))


def _read_process_file(path: Path) -> Process:
    content = safe_yaml.read(path, "process file")
    text = content.get("process") if isinstance(content, dict) else None
    if not isinstance(text, str):
        raise InputError(f"process file {str(path)!r} has no text under the key 'process'")
    if text.strip().endswith((".yaml", ".yml")):
        raise InputError(f"process file {str(path)!r} names the file {text!r}; allowed: a name or a transfer function")
    return read_process(text)
