"""A family of processes from a text with names, such as ``K/(T*s+1)*exp(-L*s)``, and ranges for the names.

The grammar is that of every process text, and the names. Where a text has none, the names are those of the template
that the process has the form of, or ``K``, its steady-state gain, and ``L``, its delay.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from importlib import resources

from lark import Lark, Token, Tree
from lark.exceptions import UnexpectedInput
from lark.visitors import Interpreter

from fopid_core.design.certificate.family import Family, FamilyTerm, Linear, Powers
from fopid_core.errors import InputError
from fopid_core.model.process import TEST_BENCH, Process, read_process
from fopid_core.model.quasipolynomial import number_text

Sides = Mapping[str, tuple[float, float]]
Branch = Token | Tree[Token]

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_RESERVED = ("s", "e", "exp")
_MOST_TERMS = 400
_HIGHEST_POWER = 60


def read_family(source: str, sides: Sides) -> Family:
    """The processes that a text stands for when its names are anywhere in their ranges.

    Parameters
    ----------
    source : str
        A text with the names; or what ``read_process`` reads, for the names of its template.
    sides : mapping
        (low, high) for each name; low = high fixes it.

    Raises
    ------
    InputError
        Naming the text or the range that cannot be used.

    Examples
    --------
    >>> family = read_family("K/(T*s+1)*exp(-L*s)", {"K": (1, 2), "T": (3, 4), "L": (0.5, 0.5)})
    >>> family.names, str(family.at((1.0, 3.0)))
    (('K', 'T'), '1/(3 s + 1) * exp(-0.5s)')
    >>> read_family("2/(3s+1)", {"T": (2, 4)}).names
    ('T',)
    """
    for name, (low, high) in sides.items():
        _check_range(name, low, high)
    named = _names_in(source, sides)
    if sides and not named:
        source = _with_names(read_process(source), tuple(sides))
    elif missing := [name for name in sides if name not in named]:
        raise InputError(f"box {missing[0]}: the process {source!r} has no such name; allowed: {', '.join(named)}")
    free = tuple(name for name, (low, high) in sides.items() if low < high)
    fixed = {name: Fraction(repr(float(low))) for name, (low, high) in sides.items() if low == high}
    quotient = _parse(source if sides else TEST_BENCH.get(source.strip(), source), free, fixed)
    family = _normalised(quotient, free, tuple((float(sides[n][0]), float(sides[n][1])) for n in free))
    middle = [0.5 * (low + high) for low, high in family.sides]
    family.at(middle)  # says what is wrong with a process that is not proper or not causal
    return family


def read_sides(box: Iterable[str]) -> Sides:
    """The ranges in texts such as ``K=0.8,1.2``.

    Examples
    --------
    >>> read_sides(["K=0.8,1.2", "L=0,0.3"])
    {'K': (0.8, 1.2), 'L': (0.0, 0.3)}
    """
    sides: dict[str, tuple[float, float]] = {}
    for text in box:
        name, equals, ends = text.partition("=")
        low, comma, high = ends.partition(",")
        try:
            side = (float(low), float(high))
        except ValueError:
            side = (math.nan, math.nan)
        if not (equals and comma) or math.isnan(side[0] + side[1]) or name.strip() in sides:
            raise InputError(f"box {text!r}; allowed: NAME=LOW,HIGH, each name once")
        sides[name.strip()] = side
    return sides


def _check_range(name: str, low: float, high: float) -> None:
    if not (_NAME.fullmatch(name) and name not in _RESERVED):
        raise InputError(f"box {name!r}; allowed: a name such as K, T or tau1, other than s, e and exp")
    if not (math.isfinite(low) and math.isfinite(high) and low <= high):
        raise InputError(f"box {name} = {low:g},{high:g}; allowed: two finite numbers, the lower one first")


def _names_in(source: str, sides: Sides) -> list[str]:
    """Which of the names occur in a text, so that the names may stand beside s without a sign: ``T s``, ``Ts``."""
    if source.strip().endswith((".yaml", ".yml")) or source.strip() in TEST_BENCH:
        return []
    longest_first = sorted([*sides, *_RESERVED], key=len, reverse=True)
    without_numbers = re.sub(r"(?<![A-Za-z_\d])(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?", " ", source)
    found = re.findall("|".join(map(re.escape, longest_first)), without_numbers)
    return [name for name in sides if name in found]


def _with_names(process: Process, names: tuple[str, ...]) -> str:
    """A process written with the names of its template, or of its gain and its delay."""
    written, values = _template(process)
    if unknown := [name for name in names if name not in values]:
        allowed = ", ".join(values) or "none"
        raise InputError(f"box {unknown[0]}: the process {process} has no such name; allowed: {allowed}, or write it "
                         f"with names, as K/(T*s+1)*exp(-L*s)")  # fmt: skip
    for name in values:
        if name not in names:
            written = re.sub(rf"\b{name}\b", number_text(values[name]), written)
    return written


def _template(process: Process) -> tuple[str, dict[str, float]]:
    """The process written with names, and their values."""
    numerator, denominator = process.numerator.terms, process.denominator.terms
    orders, sizes = [t.order for t in denominator], [t.coefficient for t in denominator]
    tail = "*exp(-(L)*s)"
    plain = len(numerator) == 1 and numerator[0].order == 0 and process.denominator.has_one_delay and orders[-1] == 0
    if plain and len(orders) in (2, 3):
        over = sizes[-1] if len(orders) == 2 else sizes[0]
        gain = {"K": numerator[0].coefficient / over}
        if len(orders) == 2:
            rest = {"T": sizes[0] / over} | ({} if orders[0] == 1 else {"alpha": orders[0]})
            power = "s" if orders[0] == 1 else "s^(alpha)"
            return f"(K)/((T)*{power}+1){tail}", gain | rest | {"L": process.delay}
        rest = {"a1": sizes[1] / over, "a0": sizes[2] / over}
        if orders[:2] == [2.0, 1.0]:
            return f"(K)/(s^2+(a1)*s+(a0)){tail}", gain | rest | {"L": process.delay}
        free = {"alpha": orders[0], "beta": orders[1]}
        return f"(K)/(s^(alpha)+(a1)*s^(beta)+(a0)){tail}", gain | rest | free | {"L": process.delay}
    still, size = process.without_delay(), process.steady_state_gain
    if not math.isfinite(size) or size == 0.0:
        return f"({still.numerator})/({still.denominator}){tail}", {"L": process.delay}
    unit = still.numerator.scaled(1.0 / size)
    return f"(K)*({unit})/({still.denominator}){tail}", {"K": size, "L": process.delay}


@dataclass(frozen=True)
class _Sum:
    """A quasi-polynomial: polynomials in the names, by order and delay."""

    terms: Mapping[tuple[Linear, Linear], Mapping[Powers, Fraction]]

    def __add__(self, other: _Sum) -> _Sum:
        terms = {key: dict(value) for key, value in self.terms.items()}
        for key, polynomial in other.terms.items():
            own = terms.setdefault(key, {})
            for powers, number in polynomial.items():
                own[powers] = own.get(powers, Fraction(0)) + number
        return _Sum(terms).cleaned()

    def __mul__(self, other: _Sum) -> _Sum:
        total = _Sum({})
        for (order, delay), polynomial in self.terms.items():
            for (order_2, delay_2), polynomial_2 in other.terms.items():
                product: dict[Powers, Fraction] = {}
                for a, x in polynomial.items():
                    for b, y in polynomial_2.items():
                        key = tuple(p + q for p, q in zip(a, b, strict=True))
                        product[key] = product.get(key, Fraction(0)) + x * y
                total = total + _Sum({(_plus(order, order_2), _plus(delay, delay_2)): product})
        return total

    def scaled(self, factor: Fraction) -> _Sum:
        """Times a number."""
        return _Sum({k: {p: factor * n for p, n in poly.items()} for k, poly in self.terms.items()}).cleaned()

    def cleaned(self) -> _Sum:
        """Without zeros."""
        kept = {key: {p: n for p, n in value.items() if n} for key, value in self.terms.items()}
        return _Sum({key: value for key, value in kept.items() if value})


@dataclass(frozen=True)
class _Quotient:
    numerator: _Sum
    denominator: _Sum

    def times(self, other: _Quotient) -> _Quotient:
        return _Quotient(self.numerator * other.numerator, self.denominator * other.denominator)

    def turned(self) -> _Quotient:
        return _Quotient(self.denominator, self.numerator)


def _plus(a: Linear, b: Linear) -> Linear:
    return tuple(x + y for x, y in zip(a, b, strict=True))


def _parse(source: str, names: tuple[str, ...], fixed: Mapping[str, Fraction]) -> _Quotient:
    """The quotient that a text stands for."""
    grammar = resources.files("fopid_core.model").joinpath("process.lark").read_text(encoding="utf-8")
    if known := [*names, *fixed]:
        words = " | ".join(f'"{name}"' for name in sorted(known, key=len, reverse=True))
        grammar += f"\n%extend symbol: PARAMETER -> parameter\nPARAMETER.2: {words}\n"
    try:
        tree = Lark(grammar, parser="lalr", propagate_positions=True).parse(source)
    except UnexpectedInput as error:
        at = int(error.pos_in_stream or 0)
        at = len(source) if at < 0 else at
        allowed = f"the names {', '.join(known)}" if known else "no names, as there is no --box"
        raise InputError(
            f"process text {source!r}, character {at + 1}: does not fit here; allowed: {allowed}"
        ) from None
    quotient: _Quotient = _Reader(source, names, fixed).visit(tree)
    return quotient


class _Reader(Interpreter[Token, _Quotient]):
    """Turns the syntax tree into a quotient, exactly: numbers are decimals."""

    def __init__(self, text: str, names: tuple[str, ...], fixed: Mapping[str, Fraction]) -> None:
        self._text, self._names, self._fixed = text, names, fixed
        self._flat: Linear = (Fraction(0),) * (1 + len(names))
        self._one = self._number(Fraction(1))

    def start(self, tree: Tree[Token]) -> _Quotient:
        return self._read(tree.children[0])

    group = start

    def number(self, tree: Tree[Token]) -> _Quotient:
        return self._number(Fraction(str(tree.children[0])))

    def laplace(self, _tree: Tree[Token]) -> _Quotient:
        return self._power_of_s((Fraction(1), *self._flat[1:]))

    def parameter(self, tree: Tree[Token]) -> _Quotient:
        name = str(tree.children[0])
        if name in self._fixed:
            return self._number(self._fixed[name])
        powers = tuple(int(other == name) for other in self._names)
        return _Quotient(_Sum({(self._flat, self._flat): {powers: Fraction(1)}}), self._one.denominator)

    def euler(self, _tree: Tree[Token]) -> _Quotient:
        return self._number(Fraction(repr(math.e)))

    def signed(self, tree: Tree[Token]) -> _Quotient:
        sign, operand = tree.children
        value = self._read(operand)
        return _Quotient(value.numerator.scaled(Fraction(-1)), value.denominator) if str(sign) == "-" else value

    def sum(self, tree: Tree[Token]) -> _Quotient:
        total, sign = self._number(Fraction(0)), Fraction(1)
        for child in tree.children:
            if isinstance(child, Token):
                sign = Fraction(-1) if str(child) == "-" else Fraction(1)
                continue
            value = self.visit(child)
            part = _Quotient(value.numerator.scaled(sign), value.denominator)
            total = self._bounded(_added(total, part))
        return total

    def product(self, tree: Tree[Token]) -> _Quotient:
        result, operator, implied = self._one, "*", False
        for child in tree.children:
            if isinstance(child, Token):
                operator, implied = str(child), False
                continue
            factor = self.visit(child)
            if operator == "/" and implied and child.data != "exponential":
                raise self._error(
                    "a product without '*' after a division is read in two ways; write a/(b*c) or (a/b)*c"
                )
            divided = operator == "/" and not implied
            if divided and not factor.numerator.terms:
                raise self._error("division by zero")
            result = self._bounded(result.times(factor.turned() if divided else factor))
            implied = True
        return result

    def exponential(self, tree: Tree[Token]) -> _Quotient:
        return self._exponential_of(self._read(tree.children[0]))

    def raise_to(self, tree: Tree[Token]) -> _Quotient:
        base, exponent = tree.children
        if isinstance(base, Tree) and base.data == "euler":
            return self._exponential_of(self._read(exponent))
        power = self._linear(self._read(exponent), "an exponent")
        value = self._read(base)
        if isinstance(base, Tree) and base.data == "laplace":
            negative = power[0] < 0 and not any(power[1:])
            return self._power_of_s(tuple(-x for x in power)).turned() if negative else self._power_of_s(power)
        if any(power[1:]) or power[0].denominator != 1 or abs(power[0]) > _HIGHEST_POWER:
            raise self._error(f"only s takes an exponent that is not a whole number up to {_HIGHEST_POWER}")
        value = value.turned() if power[0] < 0 else value
        result = self._one
        for _ in range(abs(int(power[0]))):
            result = self._bounded(result.times(value))
        return result

    def _read(self, branch: Branch) -> _Quotient:
        if isinstance(branch, Token):
            return self._number(Fraction(str(branch)))
        quotient: _Quotient = self.visit(branch)
        return quotient

    def _error(self, reason: str) -> InputError:
        return InputError(f"process text {self._text!r}: {reason}")

    def _bounded(self, quotient: _Quotient) -> _Quotient:
        size = sum(len(poly) for part in (quotient.numerator, quotient.denominator) for poly in part.terms.values())
        if size > _MOST_TERMS:
            raise self._error(f"it multiplies out to {size} terms; allowed: up to {_MOST_TERMS}")
        if not quotient.denominator.terms:
            raise self._error("division by zero")
        return quotient

    def _number(self, value: Fraction) -> _Quotient:
        one: Mapping[Powers, Fraction] = {(0,) * len(self._names): Fraction(1)}
        unit = _Sum({(self._flat, self._flat): one})
        return _Quotient(unit.scaled(value), unit)

    def _power_of_s(self, order: Linear) -> _Quotient:
        one = self._one.denominator.terms[self._flat, self._flat]
        return _Quotient(_Sum({(order, self._flat): one}), self._one.denominator)

    def _linear(self, value: _Quotient, what: str, order: Fraction = Fraction(0)) -> Linear:
        """A linear function of the names times a power of s, as a form."""
        size = len(self._names)
        place = ((order, *self._flat[1:]), self._flat)
        under = value.denominator.terms.get((self._flat, self._flat), {})
        if len(value.denominator.terms) != 1 or set(under) != {(0,) * size} or set(value.numerator.terms) - {place}:
            raise self._error(f"{what} must be a sum of numbers and names{' times s' if order else ''}")
        form = [Fraction(0)] * (1 + size)
        for powers, number in value.numerator.terms.get(place, {}).items():
            if sum(powers) > 1:
                raise self._error(f"{what} must be linear in the names")
            form[1 + powers.index(1) if any(powers) else 0] += number / under[(0,) * size]
        return tuple(form)

    def _exponential_of(self, exponent: _Quotient) -> _Quotient:
        delay = tuple(-x for x in self._linear(exponent, "the exponent of e", Fraction(1)))
        one = self._one.denominator.terms[self._flat, self._flat]
        return _Quotient(_Sum({(self._flat, delay): one}), self._one.denominator)


def _added(a: _Quotient, b: _Quotient) -> _Quotient:
    if a.denominator == b.denominator:
        return _Quotient(a.numerator + b.numerator, a.denominator)
    return _Quotient(a.numerator * b.denominator + b.numerator * a.denominator, a.denominator * b.denominator)


def _normalised(quotient: _Quotient, names: tuple[str, ...], sides: tuple[tuple[float, float], ...]) -> Family:
    """A family without a common power of s, its denominator undelayed, as ``Process`` has it."""
    if not quotient.numerator.terms:
        raise InputError("process with the numerator 0; allowed: a process that answers its input")
    parts = [list(part.terms.items()) for part in (quotient.numerator, quotient.denominator)]
    orders = [order for part in parts for (order, _), _ in part]
    delays = [delay for (_, delay), _ in parts[1]]
    zero: Linear = (Fraction(0),) * (1 + len(names))
    order, delay = _lowest(orders, sides) or zero, _lowest(delays, sides) or zero
    terms = [tuple(FamilyTerm(dict(poly), _less(o, order), _less(d, delay)) for (o, d), poly in part) for part in parts]
    return Family(terms[0], terms[1], names, sides)


def _less(a: Linear, b: Linear) -> Linear:
    return tuple(x - y for x, y in zip(a, b, strict=True))


def _lowest(forms: list[Linear], sides: tuple[tuple[float, float], ...]) -> Linear | None:
    """The form that is below all others everywhere; None when there is none."""

    def least(form: Linear) -> float:
        ends = zip(form[1:], sides, strict=True)
        return float(form[0]) + sum(min(float(x) * low, float(x) * high) for x, (low, high) in ends)

    return next((form for form in forms if all(least(_less(other, form)) >= 0.0 for other in forms)), None)
