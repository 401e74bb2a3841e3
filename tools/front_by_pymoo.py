"""Make ``tests/core/design/front/by_pymoo.csv``: the trade-off of a filtered PID on 1/(s+1)^3 as NSGA-II finds it.

With formulas of its own. Run by hand, since nothing else here needs pymoo (0.6.2): ``pip install pymoo`` and
``python tools/front_by_pymoo.py``. 300,000 designs are looked at; it takes a minute or two.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pymoo.algorithms.moo.nsga2 import NSGA2
from pymoo.core.problem import Problem
from pymoo.optimize import minimize

POPULATION, GENERATIONS, SEED = 200, 1500, 1
MS, NOISE, IAE = (1.2, 2.0), 20.0, 3.5
HORIZON = 46.9752  # [s], as fopid front chooses it
NYQUIST = np.pi / 0.01
W = np.geomspace(1e-3, NYQUIST, 300)
LOW, HIGH = np.log([0.05, 0.05, 1e-3, 0.015]), np.log([50.0, 50.0, 50.0, 5.0])
N = 1024
PERIOD = 2.0 * HORIZON
S = 8.0 / PERIOD + 2j * np.pi / PERIOD * np.arange(N + 1)
TIME = np.linspace(0.0, HORIZON, N + 1)
RISE = np.exp(8.0 / PERIOD * TIME) * 2.0 * N / PERIOD


def feedback(x: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Controller and filter at s, shape (n, points)."""
    kp, ki, kd, slow = np.exp(x).T[..., None]
    return (kp + ki / s + kd * s) / (1.0 + slow * s + (slow * s) ** 2 / 2.0)


def poles(x: np.ndarray) -> np.ndarray:
    """Largest real part of a closed-loop pole, shape (n,)."""
    kp, ki, kd, slow = np.exp(x).T
    plant = np.polymul([1.0, 3.0, 3.0, 1.0], [1.0, 0.0])
    largest = []
    for row in range(len(x)):
        polynomial = np.polymul(plant, [slow[row] ** 2 / 2.0, slow[row], 1.0])
        polynomial[-3:] += [kd[row], kp[row], ki[row]]
        largest.append(np.roots(polynomial).real.max())
    return np.array(largest)


class TradeOff(Problem):
    """IAE of a load, Ms and noise gain."""

    def __init__(self) -> None:
        super().__init__(n_var=4, n_obj=3, n_ieq_constr=5, xl=LOW, xu=HIGH)

    def _evaluate(self, x: np.ndarray, out: dict, *args: object, **kwargs: object) -> None:  # noqa: ARG002
        plant = 1.0 / (1.0 + 1j * W) ** 3
        c = feedback(x, 1j * W)
        ms = np.abs(1.0 / (1.0 + c * plant)).max(axis=1)
        noise = np.abs(c / (1.0 + c * plant)).max(axis=1)
        process = 1.0 / (1.0 + S) ** 3
        load = process / (1.0 + process * feedback(x, S)) / S
        response = np.fft.irfft(load, axis=1)[:, : N + 1] * RISE
        iae = np.abs(response).sum(axis=1) * TIME[1]
        out["F"] = np.column_stack([np.log(iae), np.log(ms), np.log(noise)])
        out["G"] = np.column_stack([ms - MS[1], MS[0] - ms, noise - NOISE, iae - IAE, poles(x)])


if __name__ == "__main__":
    algorithm = NSGA2(pop_size=POPULATION)
    found = minimize(TradeOff(), algorithm, ("n_gen", GENERATIONS), seed=SEED, verbose=False)
    table = np.column_stack([np.exp(found.X), np.exp(found.F)])
    path = Path(__file__).parents[1] / "tests/core/design/front/by_pymoo.csv"
    np.savetxt(path, table, fmt="%.6g", delimiter=",", header="kp,ki,kd,filter_time,iae,ms,noise", comments="")
