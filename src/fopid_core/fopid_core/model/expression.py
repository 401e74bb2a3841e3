"""Reading a process from text: a grammar, no ``eval``.

The grammar (``process.lark``) knows numbers, ``s``, ``+ - * / ^``, parentheses, ``exp(...)`` and implied
products as in ``9/((s+1)(s^2+2s+9))``. A text with two readings, such as ``1/(s+1)(s+2)``, is refused.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from importlib import resources

from lark import Lark, Token, Tree
from lark.exceptions import UnexpectedCharacters, UnexpectedEOF, UnexpectedInput, UnexpectedToken
from lark.visitors import Interpreter

from fopid_core.errors import ExpressionError
from fopid_core.model.quasipolynomial import QuasiPolynomial

MAX_DEGREE = 100.0  # above this a process text is a slip of the finger, not a process


@dataclass(frozen=True)
class Quotient:
    """Numerator over denominator, as read."""

    numerator: QuasiPolynomial
    denominator: QuasiPolynomial

    def constant(self) -> float | None:
        """The number this quotient is, or None when s is in it."""
        for part in (self.numerator, self.denominator):
            if any(t.order or t.delay for t in part.terms):
                return None
        if self.denominator.is_zero:
            return None
        return _value(self.numerator) / _value(self.denominator)


_ONE = QuasiPolynomial.constant(1.0)


def _value(constant: QuasiPolynomial) -> float:
    return constant.terms[0].coefficient if constant.terms else 0.0


def _number(value: float) -> Quotient:
    return Quotient(QuasiPolynomial.constant(value), _ONE)


def read_quotient(text: str) -> Quotient:
    """Read a transfer function.

    Parameters
    ----------
    text : str
        For instance ``"9/((s+1)(s^2+2s+9))"`` or ``"3.13/(433.33s+1)*exp(-50s)"``.

    Raises
    ------
    ExpressionError
        With the position of the first character that does not fit.

    Examples
    --------
    >>> str(read_quotient("(0.2s+1)(s+1)^2").numerator)
    '0.2 s^3 + 1.4 s^2 + 2.2 s + 1'
    """
    if not text.strip():
        raise ExpressionError(text, 0, "the text is empty; allowed: a transfer function in s")
    try:
        tree = _parser().parse(text)
    except UnexpectedInput as error:
        raise _explain(text, error) from None
    quotient: Quotient = _Reader(text).visit(tree)
    return quotient


@cache
def _parser() -> Lark:
    grammar = resources.files("fopid_core.model").joinpath("process.lark").read_text(encoding="utf-8")
    return Lark(grammar, parser="lalr", propagate_positions=True)


def _explain(text: str, error: UnexpectedInput) -> ExpressionError:
    if isinstance(error, UnexpectedCharacters):
        position = int(error.pos_in_stream or 0)
        return ExpressionError(text, position, f"{text[position]!r} has no meaning here; {_allowed(error.allowed)}")
    if isinstance(error, UnexpectedToken) and error.token.type != "$END":
        position = int(error.token.start_pos or 0)
        return ExpressionError(text, position, f"{str(error.token)!r} does not fit here; {_allowed(error.expected)}")
    expected = error.expected if isinstance(error, (UnexpectedToken, UnexpectedEOF)) else None
    return ExpressionError(text, len(text), f"the text ends too soon; {_allowed(expected)}")


_WORDS = {
    "NUMBER": "a number", "S": "s", "E": "e^(...)", "EXP": "exp(...)", "LPAR": "'('", "RPAR": "')'", "PLUS": "'+'",
    "MINUS": "'-'", "STAR": "'*'", "SLASH": "'/'", "_POWER": "'^'", "$END": "the end",
}  # fmt: skip


def _allowed(expected: object) -> str:
    names = expected if isinstance(expected, (set, frozenset, list)) else set(_WORDS)
    return "allowed: " + ", ".join(word for name, word in _WORDS.items() if name in names)


class _Reader(Interpreter[Token, Quotient]):
    """Turns the syntax tree into a quotient of quasi-polynomials."""

    def __init__(self, text: str) -> None:
        self._text = text

    def _error(self, tree: Tree[Token], reason: str) -> ExpressionError:
        return ExpressionError(self._text, tree.meta.start_pos, reason)

    def _parts(self, tree: Tree[Token]) -> list[Quotient]:
        return [self.visit(child) for child in tree.children if isinstance(child, Tree)]

    def _bounded(self, tree: Tree[Token], quotient: Quotient) -> Quotient:
        for part in (quotient.numerator, quotient.denominator):
            if not part.is_zero and max(part.degree, -part.lowest_order) > MAX_DEGREE:
                raise self._error(tree, f"the order {part.degree:g} is too high; allowed: up to {MAX_DEGREE:g}")
            if any(not math.isfinite(t.coefficient) for t in part.terms):
                raise self._error(tree, "a coefficient is not finite; allowed: finite numbers")
        return quotient

    def start(self, tree: Tree[Token]) -> Quotient:
        return self._parts(tree)[0]

    def group(self, tree: Tree[Token]) -> Quotient:
        return self._parts(tree)[0]

    def number(self, tree: Tree[Token]) -> Quotient:
        return self._bounded(tree, _number(float(str(tree.children[0]))))

    def laplace(self, tree: Tree[Token]) -> Quotient:
        return Quotient(QuasiPolynomial.monomial(1.0, order=1.0), _ONE)

    def euler(self, tree: Tree[Token]) -> Quotient:
        return _number(math.e)

    def add(self, tree: Tree[Token]) -> Quotient:
        a, b = self._parts(tree)
        if a.denominator == b.denominator:
            return Quotient(a.numerator + b.numerator, a.denominator)
        numerator = a.numerator * b.denominator + b.numerator * a.denominator
        return self._bounded(tree, Quotient(numerator, a.denominator * b.denominator))

    def subtract(self, tree: Tree[Token]) -> Quotient:
        a, b = self._parts(tree)
        if a.denominator == b.denominator:
            return Quotient(a.numerator - b.numerator, a.denominator)
        numerator = a.numerator * b.denominator - b.numerator * a.denominator
        return self._bounded(tree, Quotient(numerator, a.denominator * b.denominator))

    def negate(self, tree: Tree[Token]) -> Quotient:
        (a,) = self._parts(tree)
        return Quotient(-a.numerator, a.denominator)

    def multiply(self, tree: Tree[Token]) -> Quotient:
        a, b = self._parts(tree)
        return self._bounded(tree, Quotient(a.numerator * b.numerator, a.denominator * b.denominator))

    def imply(self, tree: Tree[Token]) -> Quotient:
        left, right = tree.children
        assert isinstance(left, Tree) and isinstance(right, Tree)
        if _ends_in_division(left) and not _is_exponential(right):
            raise self._error(
                right, "a product without '*' after a division is read in two ways; write a/(b*c) or (a/b)*c"
            )
        return self.multiply(tree)

    def divide(self, tree: Tree[Token]) -> Quotient:
        a, b = self._parts(tree)
        if b.numerator.is_zero:
            raise self._error(tree, "division by zero")
        return self._bounded(tree, Quotient(a.numerator * b.denominator, a.denominator * b.numerator))

    def exponential(self, tree: Tree[Token]) -> Quotient:
        return self._exponential_of(tree, self._parts(tree)[0])

    def _exponential_of(self, tree: Tree[Token], exponent: Quotient) -> Quotient:
        scale = Quotient(_ONE, exponent.denominator).constant()
        terms = exponent.numerator.terms
        if scale is None or any(t.delay or t.order not in (0.0, 1.0) for t in terms):
            raise self._error(tree, "the exponent must be a constant times s; allowed: exp(-L*s) with L >= 0")
        delay = -scale * sum(t.coefficient for t in terms if t.order == 1.0)
        if delay < 0:
            raise self._error(tree, f"exp of +{-delay:g} s looks into the future; allowed: exp(-L*s) with L >= 0")
        factor = math.exp(scale * sum(t.coefficient for t in terms if t.order == 0.0))
        return Quotient(QuasiPolynomial.monomial(factor, delay=delay), _ONE)

    def raise_to(self, tree: Tree[Token]) -> Quotient:
        base_tree, exponent_tree = tree.children
        assert isinstance(base_tree, Tree) and isinstance(exponent_tree, Tree)
        exponent = self.visit(exponent_tree)
        if base_tree.data == "euler":
            return self._exponential_of(tree, exponent)
        power = exponent.constant()
        if power is None:
            raise self._error(exponent_tree, "the exponent contains s; allowed: a number")
        return self._bounded(tree, self._power(tree, self.visit(base_tree), power))

    def _power(self, tree: Tree[Token], base: Quotient, power: float) -> Quotient:
        if abs(power) > MAX_DEGREE:
            raise self._error(tree, f"the exponent {power:g} is too high; allowed: up to {MAX_DEGREE:g}")
        if base == self.laplace(tree):
            order = QuasiPolynomial.monomial(1.0, order=abs(power))
            return Quotient(order, _ONE) if power >= 0 else Quotient(_ONE, order)
        value = base.constant()
        if value is not None and (value > 0 or (float(power).is_integer() and (value or power > 0))):
            return _number(float(value**power))
        if not float(power).is_integer():
            raise self._error(tree, f"only s and numbers take the exponent {power:g}; allowed here: whole numbers")
        if power < 0 and base.numerator.is_zero:
            raise self._error(tree, "division by zero")
        over, under = (base.numerator, base.denominator) if power >= 0 else (base.denominator, base.numerator)
        return Quotient(over ** int(abs(power)), under ** int(abs(power)))


def _is_exponential(tree: Tree[Token]) -> bool:
    if tree.data == "raise_to":
        base = tree.children[0]
        return isinstance(base, Tree) and base.data == "euler"
    return tree.data == "exponential"


def _ends_in_division(tree: Tree[Token]) -> bool:
    while tree.data == "imply":
        left = tree.children[0]
        assert isinstance(left, Tree)
        tree = left
    return tree.data == "divide"
