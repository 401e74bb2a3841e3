"""A table of gains is checked at its points and between them; the oracle takes roots of polynomials, value by value."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fopid_core.design.schedule import check_schedule
from fopid_core.errors import InputError
from fopid_core.runtime.schedule import parse_schedule


def content(process: str, points: list[dict], **more: object) -> dict:
    return {"process": process, "points": points, **more}


def check(process: str, points: list[dict], **more: object):
    given = content(process, points, **more)
    return check_schedule(parse_schedule(given), given)


def characteristic(point: dict) -> np.ndarray:
    """Of PID and K/((T s + 1)(s^2 + 2 Z s + W)): s D + (kd s^2 + kp s + ki) K, by numpy's polynomials."""
    denominator = np.polymul([point["T"], 1.0], [1.0, 2.0 * point["Z"], point["W"]])
    return np.polyadd(np.append(denominator, 0.0), point["K"] * np.array([point["kd"], point["kp"], point["ki"]]))


def sensitivity(point: dict) -> float:
    s = 1j * np.geomspace(1e-3, 1e3, 4000)
    denominator = np.polyval(np.append(np.polymul([point["T"], 1.0], [1.0, 2.0 * point["Z"], point["W"]]), 0.0), s)
    return float(np.abs(denominator / np.polyval(characteristic(point), s)).max())


def on_the_way(first: dict, second: dict) -> list[dict]:
    shares = np.linspace(0.0, 1.0, 201)
    return [{name: (1 - t) * first[name] + t * second[name] for name in first} for t in shares]


PROCESS = "K/((T*s+1)*(s^2+2*Z*s+W))"


def random_point(random: np.random.Generator, at: float) -> dict:
    return {"at": at, "kp": random.uniform(0.1, 4), "ki": random.uniform(0.05, 2), "kd": random.uniform(0, 1.5),
            "K": random.uniform(0.3, 2), "T": random.uniform(0.1, 1), "Z": random.uniform(0.05, 1),
            "W": random.uniform(0.5, 6)}  # fmt: skip


@pytest.mark.parametrize("seed", [*range(5), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(5, 25))])
def test_what_is_said_of_the_way_holds_for_every_loop_on_it(seed: int) -> None:
    random = np.random.default_rng(seed)
    first, second = random_point(random, 0.0), random_point(random, 1.0)
    (way,) = check(PROCESS, [first, second]).ways
    rows = on_the_way(first, second)
    stable = [bool(np.roots(characteristic(row)).real.max() < 0.0) for row in rows]
    if way.stable:
        assert all(stable)
        assert max(map(sensitivity, rows)) <= way.ms * (1.0 + 1e-9)
    elif way.stable is False:
        assert not all(stable)
    assert way.stable is not None or min(abs(np.roots(characteristic(row)).real.max()) for row in rows) < 0.02


@pytest.mark.slow
def test_the_draws_hold_both_kinds() -> None:
    found = []
    for seed in range(25):
        random = np.random.default_rng(seed)
        found.append(check(PROCESS, [random_point(random, 0.0), random_point(random, 1.0)]).ways[0].stable)
    assert 5 < sum(one is True for one in found) < 24


def test_two_stable_points_do_not_make_a_stable_way() -> None:
    # Gain and process trade places: kp K is 1 at both ends and 5.05^2 = 25.5 in the middle, above 8.
    found = check("K/(s+1)^3", [{"at": 0, "kp": 10.0, "K": 0.1}, {"at": 1, "kp": 0.1, "K": 10.0}])
    assert [point.stable for point in found.points] == [True, True]
    assert found.ways[0].stable is False
    assert found.unmet == ("from 0 to 1: unstable on the way",)


def test_a_resonance_that_moves_past_a_frequency_between_two_points_is_seen() -> None:
    # With Z = 0.002 the peak is 0.2 % wide and W moves it by a factor of 3. kp = 1 destabilises W < 1.6 (Routh).
    points = [{"at": k, "kp": 0.02, "W": w} for k, w in enumerate((9.0, 1.0))]
    found = check("1/((s^2+0.004*s+W)*(0.1*s+1))", points)
    rows = [{"kp": 0.02, "W": w} for w in np.linspace(9.0, 1.0, 400)]
    roots = [np.roots(np.polyadd(np.polymul([1.0, 0.004, r["W"]], [0.1, 1.0]), [r["kp"]])).real.max() for r in rows]
    assert (found.ways[0].stable is True) == (max(roots) < 0.0)
    points[0]["kp"] = 0.5  # now the resonance is driven to growth in between
    rows = [{"kp": 0.5 + t * (0.02 - 0.5), "W": 9.0 - 8.0 * t} for t in np.linspace(0, 1, 400)]
    roots = [np.roots(np.polyadd(np.polymul([1.0, 0.004, r["W"]], [0.1, 1.0]), [r["kp"]])).real.max() for r in rows]
    assert check("1/((s^2+0.004*s+W)*(0.1*s+1))", points).ways[0].stable is not True
    assert max(roots) > 0.0


def test_with_fractional_orders_and_a_delay_the_bound_is_above_every_loop_and_close_to_the_highest() -> None:
    points = [{"at": 0, "kp": 1.0, "ki": 0.5, "lam": 0.9, "kd": 0.2, "mu": 0.7, "L": 0.3},
              {"at": 1, "kp": 0.6, "ki": 0.4, "lam": 1.1, "kd": 0.1, "mu": 0.9, "L": 0.6}]  # fmt: skip
    found = check("1/(s^1.5+1)*exp(-L*s)", points, bounds={"ms_max": 2.2})
    w = np.geomspace(1e-3, 1e2, 3000)
    s = 1j * w
    peaks = []
    for t in np.linspace(0, 1, 101):
        row = {name: (1 - t) * points[0][name] + t * points[1][name] for name in points[0]}
        loop = (
            (row["kp"] + row["ki"] * s ** -row["lam"] + row["kd"] * s ** row["mu"])
            * np.exp(-row["L"] * s)
            / (s**1.5 + 1)
        )
        peaks.append(float(np.abs(1 / (1 + loop)).max()))
    assert found.ways[0].stable
    assert max(peaks) <= found.ways[0].ms < 1.3 * max(peaks)


def test_a_bound_that_is_broken_is_named_with_its_place() -> None:
    points = [{"at": 1, "kp": 1.0, "ki": 0.3}, {"at": 2, "kp": 4.0, "ki": 0.3}]
    found = check("1/(s+1)^3", points, bounds={"ms_max": 1.8}, sample_time=0.01)
    assert len(found.running) == 2
    assert found.unmet[0].startswith("at 2: max |S| = ")
    assert found.unmet[1].startswith("from 1 to 2: max |S| is not known to be below ")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"process": None}, "process = None; allowed: the text of a process"),
        ({"process": "1/(s+x)"}, "process text"),
        ({"bounds": {"ms_max": 0.9}}, "bounds.ms_max = 0.9; allowed: above 1"),
        ({"bounds": {"ms": 2}}, "allowed: a mapping with ms_max and mt_max"),
        ({"bounds": {"ms_max": math.nan}}, "bounds.ms_max = nan; allowed: above 1"),
        ({"sample_time": "x"}, "sample_time = 'x'; allowed: 1e-06 to 1e"),
        ({"points": [{"at": 1, "kp": 1, "Q": 1}, {"at": 2, "kp": 1, "Q": 1}]}, "name 'Q': not in the process"),
        ({"points": [{"at": 1, "kp": 1, "s": 1}, {"at": 2, "kp": 1, "s": 1}]}, "name 's'; allowed: one such as K"),
        ({"points": [{"at": 1, "kp": 1, "K": 1}, {"at": 2, "kp": 1}]}, r"points\[1\]: names none; allowed: those of"),
    ],
)
def test_what_cannot_be_checked_is_refused_in_one_line(given: dict, message: str) -> None:
    good = content("1/(s+1)", [{"at": 1, "kp": 1}, {"at": 2, "kp": 1}])
    with pytest.raises(InputError, match=message) as refused:
        check_schedule(parse_schedule(good | given), good | given)
    assert "\n" not in str(refused.value)
