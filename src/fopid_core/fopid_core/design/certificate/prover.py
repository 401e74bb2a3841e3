"""Certificates: what is asked, the proof, and the document that a checker can prove again."""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from fractions import Fraction
from typing import Any

from flint import ctx

from fopid_core.design.certificate.checker import check
from fopid_core.design.certificate.enclosure import Bounds, LoopEnclosure
from fopid_core.design.certificate.family import Family, FamilyTerm
from fopid_core.design.certificate.subdivision import (
    CLOSED,
    OUTSIDE,
    SPLIT,
    Effort,
    Node,
    Piece,
    Subdivider,
    Subdivision,
)
from fopid_core.model.fopid import Fopid

PRECISION = 128
"""Of the ball arithmetic [bits]."""
_FUNCTIONS = ("max |S|", "max |T|", "the noise gain")


@dataclass(frozen=True)
class Certification:
    """The answer to the question whether a loop is stable and within bounds.

    Attributes
    ----------
    certified : bool or None
        True: proved, and proved again by the checker; False: the contrary is proved; None: neither.
    bounds : Bounds
    reason : str
        In words; for None, what stood in the way.
    certified_share, failed_share : float
        Of the family's box: proved to hold, and proved not to.
    counterexample : tuple of float or None
        Parameters for which the loop fails.
    document : str or None
        The certificate; where a part of a box is proved, of that part.
    elapsed : float
        [s]
    """

    certified: bool | None
    bounds: Bounds
    reason: str
    certified_share: float
    failed_share: float
    counterexample: tuple[float, ...] | None
    document: str | None
    elapsed: float


def certify(
    family: Family, controller: Fopid, bounds: Bounds | None = None, effort: Effort | None = None,
    precision: int = PRECISION,
) -> Certification:  # fmt: skip
    """Prove that a loop is stable and within bounds, for one process or for all of a family.

    Examples
    --------
    >>> from fopid_core.model.process import read_process
    >>> found = certify(Family.of(read_process("P1")), Fopid(1.0, 0.4, 0.5), Bounds(ms_max=1.5))
    >>> found.certified, found.reason
    (True, 'stable, max |S| <= 1.5')
    >>> certify(Family.of(read_process("P1")), Fopid(9.0)).reason
    'unstable: 2 poles in the right half-plane'
    """
    begun = time.perf_counter()
    bounds = bounds or Bounds()
    with ctx.workprec(precision):
        loop = LoopEnclosure(family, controller, bounds)
        refuted = _refuted_at_once(loop)
        found = None if refuted else Subdivider(loop, effort or Effort()).run()
    if found is None:
        return Certification(False, bounds, refuted, 0.0, 1.0, None, None, time.perf_counter() - begun)
    certified, reason = _verdict(found, loop)
    document = None
    if found.closed > 0.0:
        document = _document(found, loop, precision)
        objection = check(document)
        if objection:
            certified, document = None, None
            reason = f"not known: the checker does not accept the proof ({objection})"
    point = found.counterexample.middle if found.counterexample and family.names else None
    elapsed = time.perf_counter() - begun
    return Certification(certified, bounds, reason, found.closed, found.failed, point, document, elapsed)


def _refuted_at_once(loop: LoopEnclosure) -> str:
    """What makes every loop of the family unstable, seen from the terms of f = O + F."""
    if loop.family.names:
        return ""
    terms = loop.characteristic
    if not terms:
        return "1 + L is zero everywhere"
    if not any(t.order[0] == 0 for t in terms) or sum(t.coefficient[()] for t in terms if t.order[0] == 0) == 0:
        return "unstable: a pole at the origin"
    top = max(t.order[0] for t in terms)
    level = sorted((t.delay[0], t.coefficient[()]) for t in terms if t.order[0] == top)
    if level[0][0] > min(t.delay[0] for t in terms):
        return "unstable: infinitely many poles, since the highest power of s is delayed"
    if len(level) == 2 and abs(level[1][1]) > abs(level[0][1]):
        return "unstable: infinitely many poles, since the delayed loop gain stays above 1"
    return ""


def _verdict(found: Subdivision, loop: LoopEnclosure) -> tuple[bool | None, str]:
    names, node = loop.family.names, found.counterexample
    if node is not None:
        where = f" for {', '.join(f'{n} = {v:.6g}' for n, v in zip(names, node.middle, strict=True))}" if names else ""
        return False, _failure(node, loop.bounds) + where
    if found.open == 0.0 and found.failed == 0.0:
        everywhere = ", everywhere in the region" if names else ""
        return True, f"{_claim_text(loop.bounds)}{everywhere}"
    if names:
        told = f"not known after {found.attempts} pieces: proved for {found.closed:.1%} of the region"
        widest = f" or a narrower {names[found.root.axis]}" if found.root.children else ""
        return None, f"{told}, open for {found.open:.1%}; that needs more effort{widest}"
    return None, _undecided(found.root)


def _failure(node: Node, bounds: Bounds) -> str:
    if not node.broken:
        return f"unstable: {node.zeros} pole{'s' if node.zeros > 1 else ''} in the right half-plane"
    frequency, which = node.broken[0]
    bound = (bounds.ms_max, bounds.mt_max, bounds.noise_max)[which]
    return f"{_FUNCTIONS[which]} is above {bound:g} at {frequency:.6g} rad/s"


def _undecided(root: Node) -> str:
    if not root.todo:
        return "not known: the direction of 1 + L is not clear between two pieces"
    low, high = root.todo[0]
    if low == 0.0:
        return f"not known: nothing could be proved below {high:.3g} rad/s"
    if high == math.inf:
        return f"not known: nothing could be proved above {low:.3g} rad/s"
    return f"not known: a pole or a bound is too near to decide at {low:.6g} rad/s"


def _claim_text(bounds: Bounds) -> str:
    claims = ["stable"]
    pairs = zip(_FUNCTIONS, (bounds.ms_max, bounds.mt_max, bounds.noise_max), strict=True)
    claims += [f"{name} <= {bound:g}" for name, bound in pairs if bound is not None]
    if bounds.noise_max is not None and bounds.noise_band is not None:
        claims[-1] += f" up to {bounds.noise_band:g} rad/s"
    return ", ".join(claims)


def claims_of(bounds: Bounds, share: float = 1.0) -> dict[str, Any]:
    """What a certificate claims, as its file says it."""
    return {"stable": True, **asdict(bounds), "share": share}


def _document(found: Subdivision, loop: LoopEnclosure, precision: int) -> str:
    family = loop.family
    parameters = [[name, low, high] for name, (low, high) in zip(family.names, family.sides, strict=True)]
    share = 1.0 if found.open == found.failed == 0.0 else math.floor(1e6 * found.closed) * 1e-6 * (1.0 - 1e-9)
    content = {
        "format": "fopid certificate 1",
        "process": {"numerator": _rows(family.numerator), "denominator": _rows(family.denominator)},
        "parameters": parameters,
        "region": family.region,
        "gains": list(loop.controller.gains),
        "claims": claims_of(loop.bounds, share),
        "precision": precision,
        "proof": _proof(found.root),
    }
    content = json.loads(json.dumps(content), parse_int=float)
    canonical = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return json.dumps({**content, "digest": hashlib.sha256(canonical.encode()).hexdigest()})


def _rows(terms: Sequence[FamilyTerm]) -> list[Any]:
    return [
        [
            [[_number(c), *powers] for powers, c in term.coefficient.items()],
            [_number(x) for x in term.order],
            [_number(x) for x in term.delay],
        ]
        for term in terms
    ]


def _number(value: Fraction) -> float:
    return value.numerator / value.denominator


def _proof(node: Node) -> Any:
    if node.state == OUTSIDE:
        return "outside"
    if node.state == CLOSED:
        return [_runs(node.own)]
    if node.state != SPLIT:
        return "open"
    children = [_proof(child) for child in node.children]
    return "open" if children == ["open", "open"] else [_runs(node.own), node.axis, *children]


def _runs(pieces: Sequence[Piece]) -> list[list[Any]]:
    """Chains of points, each the end of one piece and the beginning of the next."""
    runs: list[list[Any]] = []
    for piece in sorted(pieces, key=lambda p: p.low):
        if runs and runs[-1][-1] == piece.low:
            runs[-1].append(piece.high)
        else:
            runs.append([piece.low, piece.high])
    for run in runs:
        run[-1] = "inf" if run[-1] == math.inf else run[-1]
    return runs
