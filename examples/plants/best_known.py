"""The best PID and FOPID known for each plant: ``python examples/plants/best_known.py [PLANT ...]``.

Searched for on the plant itself, which no tuner can: the simplex method on one of the runs that gains are judged by,
while noise moves the control by 1 % of its range at most, and gains half as large again still do.
Written to ``best_known.json``.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from foreign_plants.gallery import GALLERY
from judging import SEEDS, judge
from scipy.optimize import minimize

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid

FILE = Path(__file__).with_name("best_known.json")
LOAD_WEIGHT, LARGER, WORSE = 2.0 / 3.0, 1.5, 1.5
"""Of the load in what is best; with gains so many times as large neither index may be so many times as large."""
NOISE_SHARE, SMALL = 0.01, 1e-6
EVALUATIONS = 90


def settings_of(numbers: Mapping[str, float]) -> dict[str, Any]:
    """The controller's settings for kp, ki, kd, lam, mu and the time of the measurement's filter."""
    gains = Fopid(*(numbers[key] for key in ("kp", "ki", "kd", "lam", "mu")))
    time = numbers["filter_time"]
    return {"gains": gains, "measurement_filter_order": 2 if time else 0, "measurement_filter_time": time}


def search(name: str, begin: Mapping[str, float], fractional: bool) -> tuple[dict[str, float], float]:
    """The best settings from there, and what they cost beside the gains the plant began with."""
    exhibit = GALLERY[name]
    (start,) = judge(name, {}, SEEDS[:1]).runs
    names = ("kp", "ki", "kd", "filter_time")
    sign = math.copysign(1.0, exhibit.gains[0])

    def numbers(x: np.ndarray) -> dict[str, float]:
        found = dict(zip(names, np.exp(x[:4]).tolist(), strict=True))
        for key in names[:3]:
            found[key] *= sign
        orders = x[4:] if fractional else (1.0, 1.0)
        return {**found, "lam": float(np.clip(orders[0], 0.5, 1.5)), "mu": float(np.clip(orders[1], 0.4, 1.6))}

    def index(settings: dict[str, Any]) -> float:
        (seen,) = judge(name, settings, SEEDS[:1]).runs
        if not seen.safe:
            return math.inf
        noisy = max(seen.restless / NOISE_SHARE, 1.0)
        return float(
            (seen.load / start.load) ** LOAD_WEIGHT * (seen.setpoint / start.setpoint) ** (1 - LOAD_WEIGHT) * noisy**2
        )

    def cost(x: np.ndarray) -> float:
        try:
            chosen = settings_of(numbers(x))
            gains = chosen["gains"]
            nominal = index(chosen)
            larger = index({**chosen, "gains": Fopid(*(LARGER * g for g in gains.gains[:3]), gains.lam, gains.mu)})
        except (InputError, ArithmeticError):
            return 1e9
        return float(min(nominal * max(larger / (WORSE * nominal), 1.0), 1e9))

    x = [math.log(max(abs(begin[key]), SMALL)) for key in names] + ([begin["lam"], begin["mu"]] if fractional else [])
    simplex = np.array([x] + [np.array(x) + row for row in np.diag([0.5, 0.5, 0.7, 0.7, -0.1, -0.1][: len(x)])])
    found = minimize(
        cost, x, method="Nelder-Mead",
        options={"maxfev": EVALUATIONS, "initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-3},
    )  # fmt: skip
    return {key: float(f"{value:.5g}") for key, value in numbers(found.x).items()}, float(found.fun)


def best(name: str) -> dict[str, dict[str, float]]:
    """The best PID, and the best FOPID from there."""
    exhibit = GALLERY[name]
    kp, ki, kd = exhibit.gains
    slow = abs(kp / ki)
    begin = {
        "kp": kp,
        "ki": ki,
        "kd": kd or 0.05 * kp * slow,
        "lam": 1.0,
        "mu": 1.0,
        "filter_time": exhibit.sample_time,
    }
    pid, _ = search(name, begin, fractional=False)
    pid, cost = search(name, pid, fractional=False)
    fopid, lower = search(name, pid, fractional=True)
    return {"PID": pid, "FOPID": fopid if lower < cost else pid}


def main() -> None:
    """Search for the plants named, or all."""
    known = json.loads(FILE.read_text()) if FILE.exists() else {}
    for name in sys.argv[1:] or GALLERY:
        known[name] = best(name)
        print(name, known[name], flush=True)
        FILE.write_text(json.dumps(known, indent=1) + "\n")


if __name__ == "__main__":
    main()
