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

MAX_DEGREE = 100.0
MAX_LENGTH = 2000
MAX_DEPTH = 30
_MAX_WORK = 50_000  # products of terms in one reading: a fifth of a second

Branch = Token | Tree[Token]


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
_S = QuasiPolynomial.monomial(1.0, order=1.0)


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
    _check_size(text)
    try:
        tree = _parser().parse(text)
    except UnexpectedInput as error:
        raise _explain(text, error) from None
    quotient: Quotient = _Reader(text).visit(tree)
    return quotient


def _check_size(text: str) -> None:
    if not text.strip():
        raise ExpressionError(text, 0, "the text is empty; allowed: a transfer function in s")
    if len(text) > MAX_LENGTH:
        raise ExpressionError(f"{text[:40]}...", 40, f"{len(text)} characters; allowed: up to {MAX_LENGTH}")
    depth = 0
    for position, character in enumerate(text):
        depth += (character == "(") - (character == ")")
        if depth > MAX_DEPTH:
            raise ExpressionError(text, position, f"too many parentheses inside each other; allowed: up to {MAX_DEPTH}")


@cache
def _parser() -> Lark:
    grammar = resources.files("fopid_core.model").joinpath("process.lark").read_text(encoding="utf-8")
    return Lark(grammar, parser="lalr", propagate_positions=True)


def _explain(text: str, error: UnexpectedInput) -> ExpressionError:
    if isinstance(error, UnexpectedCharacters):
        position = int(error.pos_in_stream or 0)
        if text[max(0, position - 1) :].startswith("sqrt"):
            return ExpressionError(text, position - 1, "a square root is a power here; allowed: (...)^0.5, as s^0.5")
        return ExpressionError(text, position, f"{text[position]!r} has no meaning here; {_allowed(error.allowed)}")
    if isinstance(error, UnexpectedToken) and error.token.type != "$END":
        position = int(error.token.start_pos or 0)
        return ExpressionError(text, position, f"{str(error.token)!r} does not fit here; {_allowed(error.expected)}")
    expected = error.expected if isinstance(error, UnexpectedToken | UnexpectedEOF) else None
    return ExpressionError(text, len(text), f"the text ends too soon; {_allowed(expected)}")


_WORDS = {
    "NUMBER": "a number", "S": "s", "E": "e^(...)", "EXP": "exp(...)", "LPAR": "'('", "RPAR": "')'", "SIGN": "'+', '-'",
    "STAR": "'*'", "SLASH": "'/'", "_POWER": "'^'", "$END": "the end",
}  # fmt: skip


def _allowed(expected: object) -> str:
    names = expected if isinstance(expected, set | frozenset | list) else set(_WORDS)
    return "allowed: " + ", ".join(word for name, word in _WORDS.items() if name in names)


class _Reader(Interpreter[Token, Quotient]):
    """Turns the syntax tree into a quotient of quasi-polynomials."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._work = 0

    def start(self, tree: Tree[Token]) -> Quotient:
        return self._read(tree.children[0])

    def group(self, tree: Tree[Token]) -> Quotient:
        return self._read(tree.children[0])

    def number(self, tree: Tree[Token]) -> Quotient:
        return self._bounded(tree, _number(float(str(tree.children[0]))))

    def laplace(self, _tree: Tree[Token]) -> Quotient:
        return Quotient(_S, _ONE)

    def euler(self, _tree: Tree[Token]) -> Quotient:
        return _number(math.e)

    def sum(self, tree: Tree[Token]) -> Quotient:
        total, sign = _number(0.0), "+"
        for child in tree.children:
            if isinstance(child, Token):
                sign = str(child)
            else:
                total = self._add(child, total, _signed(sign, self.visit(child)))
        return total

    def signed(self, tree: Tree[Token]) -> Quotient:
        sign, operand = tree.children
        return _signed(str(sign), self._read(operand))

    def product(self, tree: Tree[Token]) -> Quotient:
        result, operator, implied = _number(1.0), "*", False
        before: Tree[Token] | None = None
        for child in tree.children:
            if isinstance(child, Token):
                operator, implied = str(child), False
                continue
            if before is not None and (implied or operator == "*"):
                self._check_exponent(before)
            before = child
            factor = self.visit(child)
            if operator == "/" and not implied:
                result = self._divide(child, result, factor)
            else:
                if operator == "/" and not _is_exponential(child):
                    raise self._error(
                        child, "a product without '*' after a division is read in two ways; write a/(b*c) or (a/b)*c"
                    )
                result = self._multiply(child, result, factor)
            implied = True
        return result

    def _check_exponent(self, tree: Tree[Token]) -> None:
        """Refuse ``e^-2`` before a further factor: ``e^-2s`` may be meant as ``e^(-2s)``."""
        if tree.data != "raise_to" or not _is_exponential(tree):
            return
        exponent = tree.children[1]
        if isinstance(exponent, Tree) and exponent.data != "group" and self._read(exponent).constant() is not None:
            power = self._text[exponent.meta.start_pos : exponent.meta.end_pos]
            raise self._error(
                tree, f"a product with e^{power} is read in two ways; write e^({power}s) or (e^{power})*s"
            )

    def exponential(self, tree: Tree[Token]) -> Quotient:
        return self._exponential_of(tree, self._read(tree.children[0]))

    def raise_to(self, tree: Tree[Token]) -> Quotient:
        base, exponent = tree.children
        if isinstance(base, Tree) and base.data == "euler":
            return self._exponential_of(tree, self._read(exponent))
        power = self._read(exponent).constant()
        if power is None:
            raise self._error(exponent, "the exponent contains s; allowed: a number")
        return self._bounded(tree, self._power(tree, self._read(base), power))

    def _read(self, branch: Branch) -> Quotient:
        if isinstance(branch, Token):
            return _number(float(str(branch)))
        quotient: Quotient = self.visit(branch)
        return quotient

    def _error(self, branch: Branch, reason: str) -> ExpressionError:
        start = branch.start_pos if isinstance(branch, Token) else branch.meta.start_pos
        return ExpressionError(self._text, start or 0, reason)

    def _bounded(self, branch: Branch, quotient: Quotient) -> Quotient:
        for part in (quotient.numerator, quotient.denominator):
            if not part.is_zero and part.degree > MAX_DEGREE:
                raise self._error(branch, f"the order {part.degree:g} is too high; allowed: up to {MAX_DEGREE:g}")
            if any(not math.isfinite(x) for t in part.terms for x in (t.coefficient, t.delay)):
                raise self._error(branch, "a number is not finite; allowed: finite numbers")
        return quotient

    def _times(self, branch: Branch, a: QuasiPolynomial, b: QuasiPolynomial) -> QuasiPolynomial:
        self._work += len(a.terms) * len(b.terms)
        if self._work > _MAX_WORK:
            raise self._error(branch, "the text multiplies out to too many terms; allowed: a smaller one")
        return a * b

    def _add(self, branch: Branch, a: Quotient, b: Quotient) -> Quotient:
        if a.denominator == b.denominator:
            return Quotient(a.numerator + b.numerator, a.denominator)
        numerator = self._times(branch, a.numerator, b.denominator) + self._times(branch, b.numerator, a.denominator)
        return self._bounded(branch, Quotient(numerator, self._times(branch, a.denominator, b.denominator)))

    def _multiply(self, branch: Branch, a: Quotient, b: Quotient) -> Quotient:
        numerator = self._times(branch, a.numerator, b.numerator)
        return self._bounded(branch, Quotient(numerator, self._times(branch, a.denominator, b.denominator)))

    def _divide(self, branch: Branch, a: Quotient, b: Quotient) -> Quotient:
        if b.numerator.is_zero:
            raise self._error(branch, "division by zero")
        return self._multiply(branch, a, Quotient(b.denominator, b.numerator))

    def _exponential_of(self, branch: Branch, exponent: Quotient) -> Quotient:
        scale = Quotient(_ONE, exponent.denominator).constant()
        terms = exponent.numerator.terms
        if scale is not None and any(0.0 < t.order < 1.0 and not t.delay for t in terms):
            told = (
                "a power of s in an exponent, as of diffusion, is no ratio of sums of c s^a exp(-L s), of which alone "
                "stability is decided here; allowed: exp(-L*s) with L >= 0, or a fit learnt from its response"
            )
            raise self._error(branch, told)
        if scale is None or any(t.delay or t.order not in (0.0, 1.0) for t in terms):
            raise self._error(branch, "the exponent must be a constant times s; allowed: exp(-L*s) with L >= 0")
        delay = -scale * sum(t.coefficient for t in terms if t.order == 1.0)
        if delay < 0:
            raise self._error(branch, f"exp of +{-delay:g} s looks into the future; allowed: exp(-L*s) with L >= 0")
        constant = scale * sum(t.coefficient for t in terms if t.order == 0.0)
        if constant > 700.0:
            raise self._error(branch, f"exp({constant:g}) is not finite; allowed: finite numbers")
        return Quotient(QuasiPolynomial.monomial(math.exp(constant), delay=delay), _ONE)

    def _power(self, branch: Branch, base: Quotient, power: float) -> Quotient:
        if abs(power) > MAX_DEGREE:
            raise self._error(branch, f"the exponent {power:g} is too high; allowed: up to {MAX_DEGREE:g}")
        if base == Quotient(_S, _ONE):
            order = QuasiPolynomial.monomial(1.0, order=abs(power))
            return Quotient(order, _ONE) if power >= 0 else Quotient(_ONE, order)
        value = base.constant()
        whole = float(power).is_integer()
        if value is not None and (value > 0 or (whole and (value or power > 0))):
            return self._constant_power(branch, value, power)
        if not whole:
            raise self._error(branch, f"only s and numbers take the exponent {power:g}; allowed here: whole numbers")
        if power < 0 and base.numerator.is_zero:
            raise self._error(branch, "division by zero")
        over, under = (base.numerator, base.denominator) if power >= 0 else (base.denominator, base.numerator)
        return Quotient(*(self._repeated(branch, part, int(abs(power))) for part in (over, under)))

    def _constant_power(self, branch: Branch, value: float, power: float) -> Quotient:
        try:
            return _number(float(value**power))
        except OverflowError:
            raise self._error(branch, f"{value:g}^{power:g} is not finite; allowed: finite numbers") from None

    def _repeated(self, branch: Branch, part: QuasiPolynomial, power: int) -> QuasiPolynomial:
        if not part.is_zero and part.degree * power > MAX_DEGREE:
            raise self._error(branch, f"the order {part.degree * power:g} is too high; allowed: up to {MAX_DEGREE:g}")
        result = _ONE
        for _ in range(power):
            result = self._times(branch, result, part)
        return result


def _signed(sign: str, quotient: Quotient) -> Quotient:
    return Quotient(-quotient.numerator, quotient.denominator) if sign == "-" else quotient


def _is_exponential(tree: Tree[Token]) -> bool:
    if tree.data == "raise_to":
        base = tree.children[0]
        return isinstance(base, Tree) and base.data == "euler"
    return tree.data == "exponential"
