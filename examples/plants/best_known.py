"""The best PID and FOPID known for each plant: ``python examples/plants/best_known.py [PLANT ...] [--load]``.

Searched for on the plant itself, which no tuner can: the simplex method on one of the runs that gains are judged by,
while noise moves the control by 1 % of its range at most, and gains half as large again are safe and hardly worse; from
the gains the plant began with, and from the best of the published rules. Written to ``best_known.json``.

With ``--load`` the error after the load's step alone counts, while that after the setpoint's is no larger than it was:
what can be had at all. That is printed, over all runs.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from foreign_plants.gallery import GALLERY, known_plants
from judging import SEEDS, Judgement, judge
from scipy.optimize import minimize
from step_test import amigo, simc, step_test

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid

FILE = Path(__file__).with_name("best_known.json")
LOAD_WEIGHT, LARGER, WORSE = 2.0 / 3.0, 1.5, 1.5
"""Of the load in what is best; gains so many times as large may be worth so many times less."""
NOISE_SHARE, SMALL, NONE = 0.01, 1e-6, 1e9
EVALUATIONS = 150


def settings_of(numbers: Mapping[str, float]) -> dict[str, Any]:
    """The controller's settings for kp, ki, kd, lam, mu and the time of the measurement's filter."""
    gains = Fopid(*(numbers[key] for key in ("kp", "ki", "kd", "lam", "mu")))
    time = numbers["filter_time"]
    return {"gains": gains, "measurement_filter_order": 2 if time else 0, "measurement_filter_time": time}


def balanced(seen: Judgement, start: Judgement) -> float:
    """Both errors beside what they were."""
    return (seen.load / start.load) ** LOAD_WEIGHT * (seen.setpoint / start.setpoint) ** (1 - LOAD_WEIGHT)


def load_alone(seen: Judgement, start: Judgement) -> float:
    """That after the load's step, where the other has not grown."""
    return seen.load / start.load * max(seen.setpoint / start.setpoint, 1.0) ** 2


class Search:
    """For what is best on a plant.

    Parameters
    ----------
    name : str
    worth : callable
        What a run is worth beside that with the gains the plant began with; less is better.
    """

    def __init__(self, name: str, worth: Callable[[Judgement, Judgement], float] = balanced) -> None:
        self._name, self._worth, self._exhibit = name, worth, GALLERY[name]
        (self._start,) = judge(name, {}, SEEDS[:1]).runs

    def best(self) -> dict[str, dict[str, float]]:
        """The best PID, and the best FOPID from there."""
        begins = list(self._begins())
        found = [self._from(begin, fractional=False) for begin in (begins[0], min(begins, key=self._cost))]
        pid = self._from(min(found, key=self._cost), fractional=False)
        fopid = self._from(pid, fractional=True)
        return {"PID": pid, "FOPID": min(pid, fopid, key=self._cost)}

    def _begins(self) -> Iterator[dict[str, float]]:
        """The gains that the plant began with, with a derivative; then those of the rules."""
        (kp, ki, kd), h = self._exhibit.gains, self._exhibit.sample_time
        integer = {"lam": 1.0, "mu": 1.0}
        yield {"kp": kp, "ki": ki, "kd": kd or 0.05 * kp * abs(kp / ki), "filter_time": h, **integer}
        test = step_test(self._exhibit)
        for pid in (*simc(test, h, 1.0).values(), *amigo(test, h).values()):
            yield {"kp": pid.kp, "ki": pid.ki, "kd": pid.kd, "filter_time": pid.filter_time, **integer}

    def _from(self, begin: Mapping[str, float], fractional: bool) -> dict[str, float]:
        """The best settings from there."""
        names = ("kp", "ki", "kd", "filter_time")
        sign = math.copysign(1.0, self._exhibit.gains[0])

        def numbers(x: np.ndarray) -> dict[str, float]:
            found = dict(zip(names, np.exp(x[:4]).tolist(), strict=True))
            for key in names[:3]:
                found[key] *= sign
            orders = x[4:] if fractional else (1.0, 1.0)
            return {**found, "lam": float(np.clip(orders[0], 0.5, 1.5)), "mu": float(np.clip(orders[1], 0.4, 1.6))}

        x = [math.log(max(abs(begin[key]), SMALL)) for key in names]
        x += [begin["lam"], begin["mu"]] if fractional else []
        simplex = np.array([x] + [np.array(x) + row for row in np.diag([0.5, 0.5, 0.7, 0.7, -0.1, -0.1][: len(x)])])
        found = minimize(
            lambda at: self._cost(numbers(at)), x, method="Nelder-Mead",
            options={"maxfev": EVALUATIONS, "initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-3},
        )  # fmt: skip
        return {key: float(f"{value:.5g}") for key, value in numbers(found.x).items()}

    def _cost(self, numbers: Mapping[str, float]) -> float:
        try:
            chosen = settings_of(numbers)
            gains = chosen["gains"]
            larger = Fopid(LARGER * gains.kp, LARGER * gains.ki, LARGER * gains.kd, gains.lam, gains.mu)
            seen, with_larger = (self._seen(each) for each in (chosen, {**chosen, "gains": larger}))
        except (InputError, ArithmeticError):
            return NONE
        if not (seen.safe and with_larger.safe):
            return NONE
        worth, of_larger = (self._worth(each, self._start) for each in (seen, with_larger))
        return min(max(worth, of_larger / WORSE) * max(seen.restless / NOISE_SHARE, 1.0) ** 2, NONE)

    def _seen(self, settings: dict[str, Any]) -> Judgement:
        (seen,) = judge(self._name, settings, SEEDS[:1]).runs
        return seen


def main() -> None:
    """Search for the plants named, or all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("plants", nargs="*", default=known_plants())
    parser.add_argument("--load", action="store_true", help="the error after the load's step alone counts")
    given = parser.parse_args()
    for name in given.plants:
        found = Search(name, load_alone if given.load else balanced).best()
        print(name, found, flush=True)
        if given.load:
            for label, numbers in found.items():
                seen = judge(name, settings_of(numbers))
                told = ", ".join(f"{figure} {seen.mean(figure):.4g}" for figure in ("load", "setpoint", "restless"))
                print(f"  {label}: {told}, load from run to run {seen.scatter('load'):.2g}", flush=True)
        else:
            known = json.loads(FILE.read_text()) if FILE.exists() else {}
            FILE.write_text(json.dumps({**known, name: found}, indent=1) + "\n")


if __name__ == "__main__":
    main()
