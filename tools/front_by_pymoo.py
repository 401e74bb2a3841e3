"""Make ``tests/core/design/front/by_pymoo_*.csv``: the trade-off of a filtered PID as NSGA-II finds it.

With formulas of its own. Run by hand, since nothing else here needs pymoo (0.6.2): ``pip install pymoo`` and
``python tools/front_by_pymoo.py P1``, or P2 to P4. 300,000 designs are looked at on P1, 120,000 on the others; it takes
a minute or two each.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from pymoo.algorithms.moo.nsga2 import NSGA2
from pymoo.core.problem import Problem
from pymoo.optimize import minimize

POPULATION, SEED = 200, 1
MS, NOISE = (1.2, 2.0), 20.0
NYQUIST = np.pi / 0.01
PLANTS = {
    "P1": (1.0, [1.0, 3.0, 3.0, 1.0]),
    "P2": (9.0, np.polymul([1.0, 1.0], [1.0, 2.0, 9.0])),
    "P3": (1.0, [1.0, 4.0, 6.0, 4.0, 1.0]),
    "P4": (1.0, np.polymul(np.polymul([1.0, 1.0], [0.2, 1.0]), np.polymul([0.04, 1.0], [0.008, 1.0]))),
}
"""Numerator and denominator."""
IAE = {"P1": 3.5, "P2": 2.0, "P3": 6.0, "P4": 1.3}
HORIZON = {"P1": 46.9752, "P2": 17.0632, "P3": 67.9297, "P4": 11.0169}  # [s], as fopid front chooses it
GENERATIONS = {"P1": 1500, "P2": 600, "P3": 600, "P4": 600}
LEAST_TIME = {"P1": 0.015, "P2": 0.002, "P3": 0.015, "P4": 0.001}  # of the filter [s]
POINTS = {"P1": 1024, "P2": 1024, "P3": 1024, "P4": 2048}

NAME = sys.argv[1]
GAIN, PLANT = PLANTS[NAME]
W = np.geomspace(1e-3, NYQUIST, 300 if NAME == "P1" else 400)
LOW, HIGH = np.log([0.05, 0.05, 1e-3, LEAST_TIME[NAME]]), np.log([50.0, 50.0, 50.0, 5.0])
N = POINTS[NAME]
PERIOD = 2.0 * HORIZON[NAME]
S = 8.0 / PERIOD + 2j * np.pi / PERIOD * np.arange(N + 1)
TIME = np.linspace(0.0, HORIZON[NAME], N + 1)
RISE = np.exp(8.0 / PERIOD * TIME) * 2.0 * N / PERIOD


def feedback(x: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Controller and filter at s, shape (n, points)."""
    kp, ki, kd, slow = np.exp(x).T[..., None]
    return (kp + ki / s + kd * s) / (1.0 + slow * s + (slow * s) ** 2 / 2.0)


def poles(x: np.ndarray) -> np.ndarray:
    """Largest real part of a closed-loop pole, shape (n,)."""
    kp, ki, kd, slow = np.exp(x).T
    plant = np.polymul(PLANT, [1.0, 0.0])
    largest = []
    for row in range(len(x)):
        polynomial = np.polymul(plant, [slow[row] ** 2 / 2.0, slow[row], 1.0])
        polynomial[-3:] += GAIN * np.array([kd[row], kp[row], ki[row]])
        largest.append(np.roots(polynomial).real.max())
    return np.array(largest)


class TradeOff(Problem):
    """IAE of a load, Ms and noise gain."""

    def __init__(self) -> None:
        super().__init__(n_var=4, n_obj=3, n_ieq_constr=5, xl=LOW, xu=HIGH)

    def _evaluate(self, x: np.ndarray, out: dict, *args: object, **kwargs: object) -> None:  # noqa: ARG002
        plant = GAIN / np.polyval(PLANT, 1j * W)
        c = feedback(x, 1j * W)
        ms = np.abs(1.0 / (1.0 + c * plant)).max(axis=1)
        noise = np.abs(c / (1.0 + c * plant)).max(axis=1)
        process = GAIN / np.polyval(PLANT, S)
        load = process / (1.0 + process * feedback(x, S)) / S
        response = np.fft.irfft(load, axis=1)[:, : N + 1] * RISE
        iae = np.abs(response).sum(axis=1) * TIME[1]
        out["F"] = np.column_stack([np.log(iae), np.log(ms), np.log(noise)])
        out["G"] = np.column_stack([ms - MS[1], MS[0] - ms, noise - NOISE, iae - IAE[NAME], poles(x)])


if __name__ == "__main__":
    algorithm = NSGA2(pop_size=POPULATION)
    found = minimize(TradeOff(), algorithm, ("n_gen", GENERATIONS[NAME]), seed=SEED, verbose=False)
    table = np.column_stack([np.exp(found.X), np.exp(found.F)])
    path = Path(__file__).parents[1] / f"tests/core/design/front/by_pymoo_{NAME}.csv"
    np.savetxt(path, table, fmt="%.6g", delimiter=",", header="kp,ki,kd,filter_time,iae,ms,noise", comments="")
