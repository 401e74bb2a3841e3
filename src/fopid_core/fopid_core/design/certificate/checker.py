"""The checker of certificates: all that has to be trusted, besides the ball arithmetic of FLINT (Johansson 2017).

It shares no code with what makes them. From the numbers in one, each its shortest decimal, it proves what is claimed
piece by piece: with O = s^lam D, F = (kp s^lam + ki + kd s^(lam + mu)) N, Q = (the same) D and f = O + F, that f has no
zero in the closed right half-plane, and bounds on S = O / f, T = F / f and C S = Q / f. See docs/certificates.md.
"""

from __future__ import annotations

import hashlib
import json
import math
from fractions import Fraction
from itertools import pairwise
from typing import Any, NamedTuple

from flint import acb, arb, ctx, fmpq

_ZERO = fmpq(0)
Form = tuple[fmpq, ...]  # a constant, and a factor for each parameter
Piece = tuple[float, float, acb]  # from and to which frequency Re(f conj(direction)) > 0 and all bounds hold
Polynomial = dict[tuple[int, ...], fmpq]  # by the powers of the parameters


class _Term(NamedTuple):
    """``coefficient * s**order * exp(-delay * s)``, each a function of the parameters."""

    coefficient: Polynomial
    order: Form
    delay: Form


class _Ball(NamedTuple):
    """A term over a cell of the parameters, and its derivatives along them."""

    coefficient: arb
    order: arb
    delay: arb
    slopes: list[tuple[arb, fmpq, fmpq]]


def check(text: str) -> str:
    """Prove all that a certificate claims; why it is rejected, or nothing when all is proved."""
    try:
        content = _read(text)
        with ctx.workprec(_whole(content["precision"], 53, 4096)):
            _Proof(content).show(content["proof"])
    except (ValueError, TypeError, LookupError, AttributeError, ArithmeticError, RecursionError) as error:
        return f"rejected: {type(error).__name__} {error}"
    return ""


def _require(holds: bool, why: str) -> None:
    if not holds:
        raise ValueError(why)


def _read(text: str) -> dict[str, Any]:
    content: dict[str, Any] = json.loads(text, parse_int=float, parse_constant=_exact, object_pairs_hook=_once)
    _require(content["format"] == "fopid certificate 1", "of another format")
    names = {"format", "process", "parameters", "region", "gains", "claims", "precision", "proof", "digest"}
    _require(content.keys() == names, "fields are missing or unknown")
    rest = {name: value for name, value in content.items() if name != "digest"}
    canonical = json.dumps(rest, sort_keys=True, separators=(",", ":"), allow_nan=False)
    _require(content["digest"] == hashlib.sha256(canonical.encode()).hexdigest(), "changed: the digest does not fit")
    return content


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    _require(len(dict(pairs)) == len(pairs), "a field is given twice")
    return dict(pairs)


def _exact(number: Any) -> fmpq:
    _require(isinstance(number, float) and math.isfinite(number), f"{number!r} in place of a number")
    return fmpq(*Fraction(repr(number)).as_integer_ratio())


def _whole(number: Any, low: int, high: int) -> int:
    _require(isinstance(number, float) and number.is_integer() and low <= number <= high, f"{number!r} as an index")
    return int(number)


class _Proof:
    """The loop of a certificate, its bounds, and what shows them."""

    def __init__(self, content: dict[str, Any]) -> None:
        self.cell = [(_exact(low), _exact(high)) for _, low, high in content["parameters"]]
        self.size, self.ball = len(self.cell), {"box": False, "ball": True}[content["region"]]
        names = {str(name) for name, _, _ in content["parameters"]}
        _require(len(names) == self.size and all(low < high for low, high in self.cell), "parameters: no box")
        numerator, denominator = (self._terms(content["process"][p]) for p in ("numerator", "denominator"))
        kp, ki, kd, lam, mu = map(_exact, content["gains"])
        _require(0 <= lam <= 2 and 0 <= mu <= 2, "gains: orders outside 0 to 2")
        lam = lam if ki else _ZERO
        controller = [(gain, order) for gain, order in ((kp, lam), (ki, _ZERO), (kd, lam + mu)) if gain]
        opened, forward = _product([(fmpq(1), lam)], denominator), _product(controller, numerator)
        self.functions = [opened, forward, _product(controller, denominator)]  # O, F and Q
        self.merged = _merged(opened + forward)
        self.claims = claims = dict(content["claims"])
        bounds = enumerate(claims.pop(name) for name in ("ms_max", "mt_max", "noise_max"))
        self.bounds = [(i, _exact(bound)) for i, bound in bounds if bound is not None]
        self.band = math.inf if claims["noise_band"] is None else claims["noise_band"]
        _require(claims.keys() == {"stable", "share", "noise_band"} and claims["stable"] is True, "claims: unknown")
        _require(self.band > 0 and all(bound > 0 for _, bound in self.bounds), "claims: a bound that is not positive")

    def show(self, proof: Any) -> None:
        """Prove the claims, or raise."""
        closed, opened = self._walk(proof, self.cell, [])
        _require(closed >= _exact(self.claims["share"]) * (closed + opened) > 0, "claims: share is not covered")

    def _terms(self, rows: list[Any]) -> list[_Term]:
        terms = []
        for polynomial, order, delay in rows:
            powers = [tuple(_whole(p, 0, 100) for p in row[1:]) for row in polynomial]
            _require(len(set(powers)) == len(powers) and {self.size} >= set(map(len, powers)), "process: powers")
            _require(len(order) == len(delay) == 1 + self.size, "process: orders and delays")
            coefficient = {key: _exact(row[0]) for key, row in zip(powers, polynomial, strict=True)}
            terms.append(_Term(coefficient, tuple(map(_exact, order)), tuple(map(_exact, delay))))
        _require(len({(term.order, term.delay) for term in terms}) == len(terms), "process: a power is given twice")
        return terms

    def _walk(self, node: Any, cell: list[tuple[fmpq, fmpq]], pieces: list[Piece]) -> tuple[fmpq, fmpq]:
        """Volumes of what is proved and of what is left open in a cell; raises where a piece is not proved."""
        volume = math.prod((high - low for low, high in cell), start=fmpq(1))
        if node == "open":
            return _ZERO, volume
        if node == "outside":
            nearest = sum((max(low, -high, _ZERO) ** 2 for low, high in cell), start=_ZERO)
            _require(self.ball and nearest > 1, "proof: a cell said to be outside is not")
            return _ZERO, _ZERO
        runs, *split = node
        over = _Cell(self.functions, cell)
        pieces = pieces + [self._piece(*pair, over) for run in runs for pair in pairwise(run)]
        if not split:
            self._close(pieces, over)
            return volume, _ZERO
        axis = _whole(split[0], 0, self.size - 1)
        (low, high), closed, opened = cell[axis], _ZERO, _ZERO
        for child, half in zip(split[1:], ((low, (low + high) / 2), ((low + high) / 2, high)), strict=True):
            part = self._walk(child, [*cell[:axis], half, *cell[axis + 1 :]], pieces)
            closed, opened = closed + part[0], opened + part[1]
        return closed, opened

    def _piece(self, low: float, high: float | str, over: _Cell) -> Piece:
        end = math.inf if high == "inf" else float(high)
        _require(0.0 <= low < end and (low > 0.0 or end < math.inf), "proof: frequencies that do not rise")
        show = self._at_origin if low == 0.0 else self._tail if end == math.inf else self._between
        return (low, end, show(low, end, over, [pair for pair in self.bounds if pair[0] < 2 or low < self.band]))

    def _between(self, low: float, high: float, over: _Cell, bounds: list[tuple[int, fmpq]]) -> acb:
        """The mean value theorem in t = ln(w / wc) and the parameters, f and all else scaled by exp(-nu t)."""
        first, last = arb(_exact(low)), arb(_exact(high))
        wc = (first * last).sqrt().mid()
        t = (first / wc).log().union((last / wc).log()).union(arb(0))
        used = {0, 1} | {i for i, _ in bounds}
        centre = {i: _values(over.centres[i], self.size, wc.log(), arb(0), arb(0)) for i in used}
        f = [a + b for a, b in zip(centre[0], centre[1], strict=True)]
        nu = min(max((f[1] / f[0]).real.mid(), arb(0)), max(b.order.mid() for b in over.balls[0]))
        around = {i: _values(over.balls[i], self.size, wc.log(), t, nu) for i in used}
        g = [a + b for a, b in zip(around[0], around[1], strict=True)]
        ahead, radii = f[0].conjugate() / abs(f[0]), [t.abs_upper(), *over.radii]
        away = _positive((ahead * f[0]).real, [(ahead * slope).real for slope in g[1:]], radii, (ahead * g[0]).real)
        _require(away, f"{low!r} to {high!r} rad/s: 1 + L may vanish")
        for i, bound in bounds:
            # abs(f) >= Re(u f) and abs(A) <= Re(v A) + Im(v A)^2 / (2 Re(v A)), u and v (ahead, back) of length 1.
            back = centre[i][0].conjugate() / abs(centre[i][0])
            parts = [(ahead * arb(bound) * (j < 2) - back * (j == i), centre[j][0], around[j]) for j in used]
            middle = sum((x * c for x, c, _ in parts), start=acb(0)).real
            slopes = [sum((x * a[k + 1] for x, _, a in parts), start=acb(0)).real for k in range(len(radii))]
            a = back * around[i][0]
            middle -= a.imag**2 / (2 * a.real) if a.real > 0 else abs(a) - a.real
            all_over = arb(bound) * g[0].abs_lower() - around[i][0].abs_upper()
            _require(_positive(middle, slopes, radii, all_over), f"{low!r} to {high!r} rad/s: a bound may be broken")
        return ahead.conjugate()

    def _at_origin(self, _low: float, high: float, over: _Cell, bounds: list[tuple[int, fmpq]]) -> acb:
        """All of 0 < w <= high at once: each power of w is between 0 and its value at the end."""
        end = arb(_exact(high))
        values = [acb(0), acb(0), acb(0)]
        for i, (terms, balls) in enumerate(zip(self.functions, over.balls, strict=True)):
            for term, b in zip(terms, balls, strict=True):
                flat = not any(term.order)
                _require(flat or bool(b.order > 0), "an order may vanish")
                power = arb(1) if flat else (b.order * end.log()).exp().abs_upper() * arb(0.5, 0.5)
                turn = acb(0, b.order * arb.pi() / 2 - end * arb(0.5, 0.5) * b.delay).exp()
                values[i] += b.coefficient * power * turn
        f = values[0] + values[1]
        _require(bool(f.real > 0 or f.real < 0), "1 + L may vanish near 0 rad/s")
        held = all(arb(x) * f.abs_lower() > values[i].abs_upper() for i, x in bounds)
        _require(held, "a bound may be broken near 0 rad/s")
        return acb(1) if f.real > 0 else acb(-1)

    def _tail(self, low: float, _high: float, over: _Cell, bounds: list[tuple[int, fmpq]]) -> acb:
        """All s of the right half-plane with abs(s) >= low: the undelayed leading term of f outweighs the rest."""
        log_w, lead = arb(_exact(low)).log(), self._lead(over)
        top = _over(lead, over.sides)
        _require(low >= 1.0 and not any(lead.delay), "the tail begins below 1 rad/s, or its leading term is delayed")
        _require(bool(abs(top.coefficient) > 0), "the leading coefficient may vanish")

        def share(terms: list[_Term]) -> arb:
            total = sum(term == lead for term in terms) * top.coefficient.abs_lower()
            for term in (term for term in terms if term != lead):
                gap = _linear(tuple(a - b for a, b in zip(lead.order, term.order, strict=True)), over.sides)
                _require(bool(gap >= 0), "another order may be the highest")
                total += _over(term, over.sides).coefficient.abs_upper() * (-gap * log_w).exp()
            return (total / top.coefficient.abs_lower()).abs_upper()

        rest = share(self.merged) - 1
        _require(bool(rest < 1), f"from {low!r} rad/s on: 1 + L may vanish")
        held = all(share(self.functions[i]) < arb(x) * (1 - rest) for i, x in bounds)
        _require(held, f"from {low!r} rad/s on: a bound may be broken")
        return acb(1) if top.coefficient > 0 else acb(-1)

    def _lead(self, over: _Cell) -> _Term:
        """The undelayed term of the highest order in the middle of a cell."""
        point = (fmpq(1), *over.middle)
        orders = [sum((a * b for a, b in zip(t.order, point, strict=True)), start=_ZERO) for t in self.merged]
        return max(zip(orders, self.merged, strict=True), key=lambda pair: (not any(pair[1].delay), pair[0]))[1]

    def _close(self, pieces: list[Piece], over: _Cell) -> None:
        """The pieces cover all frequencies, and f turns along them as it does without a zero to the right."""
        chain = sorted(pieces, key=lambda piece: piece[0])
        ends = [0.0, *(high for _, high, _ in chain)]
        _require(ends[-1] == math.inf, "proof: the tail is missing")
        _require(all(low == end for (low, _, _), end in zip(chain, ends, strict=False)), "proof: a gap or an overlap")
        order = _linear(self._lead(over).order, [arb(x) for x in over.middle])
        directions = [direction for _, _, direction in chain]
        directions[-1] *= acb(0, order * arb.pi() / 2).exp()
        turns = [(b * a.conjugate()).arg() for a, b in pairwise(directions)]
        zeros = order / 2 - sum(turns, start=arb(0)) / arb.pi()
        _require(bool(abs(zeros) < fmpq(1, 2)), f"{zeros.mid()} zeros in the right half-plane")


class _Cell:
    """What of the loop does not depend on frequency, over a cell of the parameters and at its middle."""

    def __init__(self, functions: list[list[_Term]], cell: list[tuple[fmpq, fmpq]]) -> None:
        self.middle = [(low + high) / 2 for low, high in cell]
        self.sides = [arb(low).union(arb(high)) for low, high in cell]
        self.radii = [arb((high - low) / 2) for low, high in cell]
        self.balls = [[_over(term, self.sides) for term in terms] for terms in functions]
        self.centres = [[_over(term, [arb(x) for x in self.middle]) for term in terms] for terms in functions]
        for form in (form for part in functions for term in part for form in term[1:]):
            low = form[0] + sum((min(a * x, a * y) for a, (x, y) in zip(form[1:], cell, strict=True)), start=_ZERO)
            _require(low >= 0, "a negative order or delay")


def _product(factors: list[tuple[fmpq, fmpq]], terms: list[_Term]) -> list[_Term]:
    return [
        _Term({p: c * n for p, n in t.coefficient.items()}, (t.order[0] + order, *t.order[1:]), t.delay)
        for c, order in factors
        for t in terms
    ]


def _merged(terms: list[_Term]) -> list[_Term]:
    found: dict[tuple[Form, Form], Polynomial] = {}
    for term in terms:
        sums = found.setdefault((term.order, term.delay), {})
        for powers, number in term.coefficient.items():
            sums[powers] = sums.get(powers, _ZERO) + number
    return [_Term(sums, *key) for key, sums in found.items() if any(sums.values())]


def _linear(form: Form, sides: list[arb]) -> arb:
    return sum((arb(factor) * side for factor, side in zip(form[1:], sides, strict=True)), start=arb(form[0]))


def _over(term: _Term, sides: list[arb]) -> _Ball:
    coefficient, slopes = arb(0), [arb(0) for _ in sides]
    for powers, number in term.coefficient.items():
        coefficient += math.prod((x for x, p in zip(sides, powers, strict=True) for _ in range(p)), start=arb(number))
        for axis, own in enumerate(powers):
            rest = [x for i, (x, p) in enumerate(zip(sides, powers, strict=True)) for _ in range(p - (i == axis))]
            slopes[axis] += math.prod(rest, start=arb(number) * own) if own else 0
    rates = list(zip(slopes, term.order[1:], term.delay[1:], strict=True))
    return _Ball(coefficient, _linear(term.order, sides), _linear(term.delay, sides), rates)


def _values(balls: list[_Ball], size: int, log_wc: arb, t: arb, nu: arb) -> list[acb]:
    """The sum of terms times exp(-nu t) at w = wc exp(t), and its derivatives along t and the parameters."""
    quarter, w = arb.pi() / 2, (log_wc + t).exp()
    log_s = acb(log_wc + t, quarter)
    total = [acb(0)] * (2 + size)
    for b in balls:
        rate = b.order - nu
        factor = acb(b.order * log_wc + rate * t, b.order * quarter - w * b.delay).exp()
        value = b.coefficient * factor
        total[0] += value
        total[1] += value * acb(rate, -w * b.delay)
        for i, (coefficient, order, delay) in enumerate(b.slopes):
            total[2 + i] += factor * coefficient + value * (log_s * order - acb(0, w) * delay)
    return total


def _positive(middle: arb, slopes: list[arb], radii: list[arb], all_over: arb) -> bool:
    """Whether a function is positive on a box: from its middle by its slopes, or all over at once."""
    return bool(middle > sum((abs(a) * r for a, r in zip(slopes, radii, strict=True)), start=arb(0)) or all_over > 0)
