"""The ellipsoid of a learnt model is certified as a whole, or a member that fails is found."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from fopid_core.design.certificate.checker import check
from fopid_core.design.certificate.ellipsoid import REGIONS, ellipsoid_family, learnt_family
from fopid_core.design.certificate.enclosure import Bounds
from fopid_core.design.certificate.prover import certify
from fopid_core.design.certificate.subdivision import Effort
from fopid_core.design.identification.identified_model import IdentifiedModel
from fopid_core.design.identification.identify import identify
from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.templates import TEMPLATES

from ..identification.recorded import step_record

VALUES = {"K": 2.0, "T": 3.0, "L": 0.5}
AXES = np.array([[0.3, 0.1, 0.0], [0.4, -0.1, 0.05], [0.0, 0.05, 0.1]])
GAINS = Fopid(1.0, 0.35)


@pytest.fixture(scope="module")
def learnt() -> IdentifiedModel:
    best = identify(step_record("P1", 20.0, 0.02, noise=0.02), "foptd,soptd").best
    assert best is not None
    return best


def peaks(members: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Max |S| of first-order members (rows of K, T, L) with GAINS, as a formula."""
    gain, lag, delay = (column[:, None] for column in members.T)
    s = 1j * w
    forward = gain * np.exp(-delay * s) / (lag * s + 1.0) * (GAINS.kp + GAINS.ki / s)
    return np.asarray(np.abs(1.0 / (1.0 + forward)).max(axis=1))


def test_members_are_the_templates_processes_and_all_of_the_ellipsoid() -> None:
    family = ellipsoid_family("foptd", VALUES, AXES @ AXES.T)
    rng = np.random.default_rng(1)
    u = rng.standard_normal((50, 3))
    u *= rng.random((50, 1)) / np.linalg.norm(u, axis=1)[:, None]
    s = np.array([0.1j, 1.0 + 2.0j])
    for row in u:
        terms = family.numerator[0].at(row)
        lag = next(term.at(row).coefficient for term in family.denominator if term.order[0] == 1)
        found = np.array([terms.coefficient, lag, terms.delay])
        away = found - list(VALUES.values())
        assert away @ np.linalg.inv(AXES @ AXES.T) @ away == pytest.approx(row @ row)
        expected = TEMPLATES["foptd"].process(dict(zip(VALUES, found, strict=True)))
        assert family.at(row)(s) == pytest.approx(expected(s), rel=1e-12)


def test_an_ellipsoid_is_certified_where_the_box_about_it_is_not() -> None:
    """The tallest peak within is found by 200,000 samples; long axes that lean make the box much larger."""
    matrix = np.diag([1.0, 1.0, 0.02]) @ np.array([[1, 0.98, 0], [0.98, 1, 0], [0, 0, 1]]) @ np.diag([1.0, 1.0, 0.02])
    rng = np.random.default_rng(2)
    u = rng.standard_normal((4000, 3))
    u /= np.linalg.norm(u, axis=1)[:, None]
    members = np.array(list(VALUES.values())) + u @ np.linalg.cholesky(matrix).T
    tallest = peaks(members, np.geomspace(0.05, 50.0, 400)).max()
    found = certify(ellipsoid_family("foptd", VALUES, matrix), GAINS, Bounds(1.02 * tallest), Effort(20_000))
    assert found.certified is True, found.reason
    assert found.document is not None
    assert check(found.document) == ""
    below = certify(
        ellipsoid_family("foptd", VALUES, matrix), GAINS, Bounds(0.98 * tallest), Effort(20_000, open_share=0.9)
    )
    assert below.certified is False
    assert below.counterexample is not None
    assert np.linalg.norm(below.counterexample) <= 1.0
    corner = peaks(np.array([[3.0, 2.0, 0.52]]), np.geomspace(0.05, 50.0, 400))[0]
    assert corner > 1.1 * tallest  # which a proof for the box would have to cover


def test_delays_below_zero_are_cut_off_and_no_others() -> None:
    family = ellipsoid_family("foptd", {"K": 1.0, "T": 1.0, "L": 0.1}, np.diag([0.01, 0.01, 0.04]))
    low, high = family.sides[0]
    assert (low, high) == (pytest.approx(-0.5), 1.0)
    assert family.at((low, 0.0, 0.0)).delay == pytest.approx(0.0, abs=1e-15)
    found = certify(family, Fopid(1.0, 1.0), Bounds(2.0), Effort(20_000))
    assert found.certified is True, found.reason


def test_a_certificate_of_a_ball_says_outside_only_of_what_is() -> None:
    document = certify(ellipsoid_family("foptd", VALUES, AXES @ AXES.T), GAINS, Bounds(1.45), Effort(2500)).document
    assert document is not None
    content = json.loads(document)
    assert '"outside"' in document
    assert content["region"] == "ball"


@pytest.mark.parametrize("region", REGIONS)
def test_what_a_record_leaves_possible_is_certified(learnt: IdentifiedModel, region: str) -> None:
    family = learnt_family(learnt, region)
    found = certify(family, Fopid(0.5, 0.2), Bounds(2.0), Effort(20_000))
    assert found.certified is True, found.reason
    assert found.document is not None
    assert check(found.document) == ""
    assert not certify(family, Fopid(60.0, 0.2), Bounds(), Effort(20_000)).certified


def test_the_ellipsoid_covers_as_many_draws_as_it_says(learnt: IdentifiedModel) -> None:
    middle = np.array(list(learnt.parameters.values()))
    drawn = np.random.default_rng(3).multivariate_normal(middle, learnt.parameter_covariance, 20_000)
    family = learnt_family(learnt, "ellipsoid", 0.9)
    origin, ends = (0.0,) * len(family.names), np.eye(len(family.names))

    def numbers(u: np.ndarray) -> np.ndarray:
        gain = family.numerator[0].at(u)
        rest = [term.at(u).coefficient for term in family.denominator if any(term.coefficient.values()) and any(
            any(powers) for powers in term.coefficient)]  # fmt: skip
        return np.array([gain.coefficient, *rest, gain.delay])

    start = numbers(np.array(origin))
    axes = np.stack([numbers(0.5 * end) - start for end in ends], axis=1) / 0.5
    assert start == pytest.approx(middle)
    inside = np.linalg.norm(np.linalg.solve(axes, (drawn - middle).T), axis=0) <= 1.0
    assert inside.mean() == pytest.approx(0.9, abs=4.0 * math.sqrt(0.09 / 20_000))


@pytest.mark.parametrize(("region", "confidence"), [("ball", 0.9), ("box", 1.0), ("ellipsoid", 0.0)])
def test_what_is_no_region_is_named(learnt: IdentifiedModel, region: str, confidence: float) -> None:
    with pytest.raises(InputError, match="allowed"):
        learnt_family(learnt, region, confidence)


def test_an_order_that_may_be_negative_is_named() -> None:
    with pytest.raises(InputError, match="alpha"):
        ellipsoid_family("nioptd1", {"K": 1.0, "T": 1.0, "alpha": 0.5, "L": 0.1}, np.diag([0.01, 0.01, 0.3, 0.001]))
