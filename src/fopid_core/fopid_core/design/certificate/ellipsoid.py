"""What a record leaves possible, as a family: the covariance ellipsoid of a learnt model, or the box about it.

The model's parameters are linear in u1, u2, ... of the unit ball. Only the first of these moves the delay, so that
delays below zero are cut off by its range.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from fractions import Fraction

import numpy as np
from scipy.special import chdtri

from fopid_core.design.certificate.family import BALL, BOX, Family, FamilyTerm, Linear, decimal
from fopid_core.design.identification.identified_model import IdentifiedModel
from fopid_core.design.specification import require
from fopid_core.errors import InputError
from fopid_core.model.arrays import Floats

REGIONS = ("ellipsoid", "box")
CONFIDENCE = 0.95
"""That the true parameters lie in the ellipsoid, if the model's structure is that of the process."""
_NOTHING = 1e-9  # of a half axis, beside the parameter
_DENOMINATORS: Mapping[str, tuple[tuple[str | int, str | int], ...]] = {
    "foptd": (("T", 1), (1, 0)),
    "soptd": ((1, 2), ("a1", 1), ("a0", 0)),
    "nioptd1": (("T", "alpha"), (1, 0)),
    "nioptd2": ((1, "alpha"), ("a1", "beta"), ("a0", 0)),
}
"""Coefficient and order of each term: a number or the name of a parameter (eqs. (6) to (9))."""


def learnt_family(model: IdentifiedModel, region: str = "ellipsoid", confidence: float = CONFIDENCE) -> Family:
    """What a learnt model may be in truth.

    Parameters
    ----------
    model : IdentifiedModel
    region : str
        ``ellipsoid``, the covariance's; or ``box``, the smallest one about it.
    confidence : float
        That the true parameters lie in the ellipsoid, by the chi-squared distribution.

    Raises
    ------
    InputError
        Where an order would be negative, or nothing is uncertain.
    """
    require(region in REGIONS, "region", region, " or ".join(REGIONS))
    require(0.0 < confidence < 1.0, "confidence", confidence, "between 0 and 1")
    spread = model.parameter_covariance
    known = np.sqrt(np.diag(spread)) <= _NOTHING * np.maximum(np.abs(list(model.parameters.values())), _NOTHING)
    reach = float(chdtri(max(int((~known).sum()), 1), 1.0 - confidence))
    if known.all():
        raise InputError(f"model {model.process} without a covariance; allowed: one learnt from a noisy record")
    build = ellipsoid_family if region == "ellipsoid" else box_family
    return build(model.template, model.parameters, reach * spread)


def ellipsoid_family(template: str, values: Mapping[str, float], matrix: Floats) -> Family:
    """Processes of a template whose parameters p have ``(p - values) inverse(matrix) (p - values) <= 1``.

    Parameters
    ----------
    template : str
        Of an identified model.
    values : mapping
        The n parameters in the middle.
    matrix : ndarray, shape (n, n)
        Positive semidefinite, rows in the order of ``values``: the covariance times a quantile.

    Examples
    --------
    >>> family = ellipsoid_family("foptd", {"K": 2.0, "T": 3.0, "L": 0.5}, np.diag([0.25, 0.04, 0.01]))
    >>> family.names, str(family.at((0.0, 0.0, 1.0)))
    (('u1', 'u2', 'u3'), '2/(3.2 s + 1) * exp(-0.5s)')
    """
    names = sorted(values, key=lambda name: name != "L")
    order = [list(values).index(name) for name in names]
    axes = _lower_root(np.asarray(matrix, dtype=np.float64)[np.ix_(order, order)])
    forms = {name: (decimal(values[name]), *map(decimal, row)) for name, row in zip(names, axes.tolist(), strict=True)}
    sides = [(-1.0, 1.0)] * axes.shape[1]
    _, *delays = forms.get("L", (Fraction(0),))
    if delays and forms["L"][0] < abs(delays[0]):
        sides[0] = (_not_below(-forms["L"][0] / delays[0]), 1.0)
    return _family(template, forms, tuple(f"u{i + 1}" for i in range(axes.shape[1])), tuple(sides), BALL)


def box_family(template: str, values: Mapping[str, float], matrix: Floats) -> Family:
    """Processes of a template whose parameters are in the smallest box about that ellipsoid.

    Examples
    --------
    >>> family = box_family("foptd", {"K": 2.0, "T": 3.0, "L": 0.5}, np.diag([0.25, 0.0, 1.0]))
    >>> family.names, family.sides
    (('K', 'L'), ((1.5, 2.5), (0.0, 1.5)))
    """
    halves = dict(zip(values, np.sqrt(np.diag(matrix)).tolist(), strict=True))
    free = [name for name, half in halves.items() if values[name] - half < values[name] + half]
    sides = {name: (values[name] - halves[name], values[name] + halves[name]) for name in free}
    if "L" in sides:
        sides["L"] = (max(sides["L"][0], 0.0), sides["L"][1])
    forms = {name: (decimal(0.0 if name in free else value), *(Fraction(int(name == other)) for other in free))
             for name, value in values.items()}  # fmt: skip
    return _family(template, forms, tuple(free), tuple(sides.values()), BOX)


def _family(
    template: str, forms: Mapping[str, Linear], names: tuple[str, ...], sides: tuple[tuple[float, float], ...],
    region: str,
) -> Family:  # fmt: skip
    for name in {"alpha", "beta"} & set(forms):
        middle, *factors = forms[name]
        lowest = middle + sum(min(c * decimal(end) for end in side) for c, side in zip(factors, sides, strict=True))
        if lowest <= 0:
            raise InputError(f"model that leaves {name} = {float(lowest):.3g} possible; allowed: orders above 0")
    flat = (Fraction(0),) * (1 + len(names))

    def form(what: str | int) -> Linear:
        return forms[what] if isinstance(what, str) else (Fraction(what), *flat[1:])

    numerator = [(name, int(name[1:])) for name in forms if name.startswith("b") and name[1:].isdigit()] or [("K", 0)]
    rational = [(name, int(name[1:])) for name in forms if name.startswith("a") and name[1:].isdigit()]
    denominator = _DENOMINATORS.get(template, (*rational, (1, 0)))
    delay = form("L" if "L" in forms else 0)
    return Family(
        tuple(FamilyTerm(_polynomial(form(c)), form(order), delay) for c, order in numerator),
        tuple(FamilyTerm(_polynomial(form(c)), form(order), flat) for c, order in denominator),
        names,
        sides,
        region,
    )


def _lower_root(matrix: Floats) -> Floats:
    """A lower triangular root, shape (n, k), without columns that are nothing."""
    values, vectors = np.linalg.eigh(matrix)
    root = np.linalg.qr((vectors * np.sqrt(np.maximum(values, 0.0))).T)[1].T
    root = root * np.where(np.diag(root) < 0.0, -1.0, 1.0)
    kept = np.abs(root).max(axis=0) > 0.0
    lower: Floats = np.tril(root)[:, kept]
    return lower


def _not_below(value: Fraction) -> float:
    """The first double whose decimal is not below a number."""
    near = float(value)
    while decimal(near) < value:
        near = math.nextafter(near, math.inf)
    return near


def _polynomial(form: Linear) -> dict[tuple[int, ...], Fraction]:
    size = len(form) - 1
    powers = [(0,) * size, *(tuple(int(i == j) for i in range(size)) for j in range(size))]
    return {key: number for key, number in zip(powers, form, strict=True) if number}
