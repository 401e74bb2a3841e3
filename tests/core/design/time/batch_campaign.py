"""The optimum is the optimum, on the whole test batch: seeds, restrictions, and a long differential evolution::

    python -m tests.core.design.time.batch_campaign build/batch.jsonl

Appends a row for each tuning and goes on where it was stopped; ``--summary`` only tells what the rows say.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import differential_evolution

from fopid_core.data import test_batch as published_batch
from fopid_core.design.time.problem import TimeProblem
from fopid_core.design.time.proposal import time_specification
from fopid_core.design.tuner import TuningRequest, tune
from fopid_core.model.process import Process
from fopid_core.model.stability import stable_mask
from fopid_core.study.benchmarks.batch import SPECIFICATIONS

BATCH = published_batch()
SEEDS = 3
RESTRICTIONS: Mapping[str, Mapping[str, float]] = {
    "ki=0": {"ki": 0.0},
    "kd=0": {"kd": 0.0},
    "lam=mu=1": {"lam": 1.0, "mu": 1.0},
    "ki=0 mu=1": {"ki": 0.0, "mu": 1.0},
    "kd=0 lam=1": {"kd": 0.0, "lam": 1.0},
}
INTEGRATES, ORDERS = "P6", (0.05, 2.0)
"""The family that does, and the range of lam when none is named."""
STRIDE = 37
"""Of the processes, so that a part of the rows is about all families."""
EVOLVED = 32
"""Processes on which differential evolution is run, ITAE at Ms 1.6."""
SPREAD, BEATEN, EVOLUTION = 5e-3, 3.5e-3, 1e-2
"""What is allowed: of the costs of all seeds; of a restriction below the whole, which a simpler structure that is
preferred may cost; of the evolution below the tuning."""

Problem = tuple[str, str, float]
Key = tuple[str, str, float, str]


def request(name: str, index: str, ms_max: float, **options: Any) -> TuningRequest:
    """A tuning of a process of the batch.

    Those that integrate have the best response to a setpoint with an integral that hardly acts. Restrictions that name
    the integral may have that, and so may the whole: with lam's range named, no load has to fade.
    """
    named = {"lam": ORDERS} if name.startswith(INTEGRATES) and "lam" not in options.get("fixed", {}) else {}
    process = Process.parse(BATCH[name])
    return TuningRequest(process, method="time", index=index, ms_max=ms_max, bounds=named, **options)


def keys() -> Iterator[Key]:
    """Every row there is to be: the evolution, which is soon done, then all seeds, then the restrictions.

    Of each process one specification after the other, another one of the next process: what has been run when it is
    stopped is a sample of all processes and of all specifications.
    """
    names = [list(BATCH)[i * STRIDE % len(BATCH)] for i in range(len(BATCH))]
    for name in names[:EVOLVED]:
        yield name, *SPECIFICATIONS[0], "evolution"
    for variants in ([f"seed {seed}" for seed in range(SEEDS)], RESTRICTIONS):
        for turn in range(len(SPECIFICATIONS)):
            for i, name in enumerate(names):
                for variant in variants:
                    yield name, *SPECIFICATIONS[(i + turn) % len(SPECIFICATIONS)], variant


def row(key: Key) -> dict[str, Any]:
    """One tuning, or one evolution."""
    name, index, ms_max, variant = key
    begun = time.process_time()
    if variant == "evolution":
        found = {"cost": evolved(request(name, index, ms_max))}
    else:
        seed = int(variant.removeprefix("seed ")) if variant.startswith("seed ") else 0
        result = tune(request(name, index, ms_max, seed=seed, fixed=RESTRICTIONS.get(variant, {})))
        found = {
            "cost": result.cost,
            "success": result.success,
            "unmet": result.unmet,
            "at_edge": result.at_edge,
            "structure": result.structure,
            "gains": result.controller and result.controller.gains,
        }
    return {"key": key, "seconds": time.process_time() - begun, **found}


def evolved(asked: TuningRequest, generations: int = 400) -> float:
    """The best cost that differential evolution finds for the same box, bounds and cost, logarithmic in the gains."""
    problem = TimeProblem(asked.process, time_specification(asked), density=60).changed(watch_control=True)
    low, high = problem.box.T
    least = 1e-4 * problem.scale[:3]

    def gains(x: np.ndarray) -> np.ndarray:
        size = np.exp(x[:3])
        parts = np.where(size < 2.0 * least[:, None], 0.0, size)
        return np.clip(np.concatenate([parts, x[3:]]).T, low, high)

    def cost(x: np.ndarray) -> np.ndarray:
        rows = gains(x)
        value, slack = problem.cost_and_slack(rows)
        broken = np.minimum(slack.min(axis=1), 0.0)
        allowed = stable_mask(asked.process, rows)
        return np.where(allowed & (broken == 0.0), value, 1e6 * np.where(allowed, 1.0 - broken, 1e3))

    ranges = [*zip(np.log(least), np.log(1e3 * problem.scale[:3]), strict=True), *zip(low[3:], high[3:], strict=True)]
    found = differential_evolution(
        cost, ranges, maxiter=generations, popsize=16, tol=1e-8, seed=0, polish=False, vectorized=True,
        updating="deferred",
    )  # fmt: skip
    return float(found.fun)


def read(out: Path) -> dict[Key, dict[str, Any]]:
    """The rows there are; of a key that was run again the last."""
    lines = out.read_text(encoding="utf-8").splitlines() if out.exists() else []
    return {tuple(found["key"]): found for found in map(json.loads, lines)}


def by_problem(rows: Mapping[Key, Mapping[str, Any]]) -> dict[Problem, dict[str, Mapping[str, Any]]]:
    """The rows of each problem by variant."""
    found: dict[Problem, dict[str, Mapping[str, Any]]] = {}
    for (*problem, variant), own in rows.items():
        found.setdefault(tuple(problem), {})[variant] = own  # type: ignore[arg-type]
    return found


def faults(rows: Mapping[Key, Mapping[str, Any]]) -> Iterator[str]:
    """What must not be: an optimum that depends on the seed, or that something restricted or slower beats."""
    for problem, own in by_problem(rows).items():
        whole = [found for variant, found in own.items() if variant.startswith("seed ")]
        for found in whole:
            if not found["success"]:
                yield f"{problem} {found['key'][3]}: {found['unmet']}"
        costs = [found["cost"] for found in whole]
        if costs and not max(costs) <= (1.0 + SPREAD) * min(costs):
            yield f"{problem}: costs {costs} by seed, {100 * (max(costs) / min(costs) - 1):.2g} % apart"
        for variant, found in own.items():
            allowed = BEATEN if variant in RESTRICTIONS else EVOLUTION if variant == "evolution" else 1.0
            if costs and found.get("success", True) and not max(costs) * (1.0 - allowed) <= found["cost"]:
                both = f"{found['cost']:.6g}, the whole {max(costs):.6g}"
                yield f"{problem}: {variant} costs {both}, {found.get('gains')}"


def summary(rows: Mapping[Key, Mapping[str, Any]]) -> str:
    """The figures in words."""
    problems = by_problem(rows)
    told, spreads, beaten, evolution, restricted = [], [], [], [], 0
    seconds = [own["seed 0"]["seconds"] for own in problems.values() if "seed 0" in own]
    met = [found["success"] for key, found in rows.items() if key[3].startswith("seed ")]
    edges = sum(bool(found["at_edge"]) for key, found in rows.items() if key[3] == "seed 0")
    for own in problems.values():
        costs = [found["cost"] for variant, found in own.items() if variant.startswith("seed ")]
        if len(costs) == SEEDS:
            spreads.append(max(costs) / min(costs) - 1.0)
        for variant, found in own.items():
            if costs and variant in RESTRICTIONS and found["success"]:
                restricted += 1
                beaten.append(max(costs) / found["cost"] - 1.0)
            elif costs and variant == "evolution":
                evolution.append(max(costs) / found["cost"] - 1.0)
    told.append(f"{len(met)} tunings, {100 * statistics.fmean(met):.2f} % met; {edges} at an edge with seed 0")
    told.append(f"processor time: median {statistics.median(seconds):.2f} s, worst {max(seconds):.2f} s")
    if spreads:
        apart = f"median {100 * statistics.median(spreads):.2g} %, worst {100 * max(spreads):.2g} %"
        told.append(f"spread of {SEEDS} seeds on {len(spreads)} problems: {apart}")
    if beaten:
        told.append(f"{restricted} restrictions: the whole costs at most {100 * max(beaten):.2g} % more")
    if evolution:
        apart = f"{100 * min(evolution):.2g} to {100 * max(evolution):.2g} %"
        told.append(f"differential evolution on {len(evolution)}: ours costs {apart} more")
    return "\n".join(told)


def main() -> None:
    """Run what is missing, and say what came out."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--summary", action="store_true", help="run nothing")
    parser.add_argument("--again", action="store_true", help="run those again that were at fault")
    given = parser.parse_args()
    rows = read(given.out)
    if given.again:
        wrong = " ".join(faults(rows))
        rows = {key: found for key, found in rows.items() if str(key[:3]) not in wrong}
    with given.out.open("a", encoding="utf-8") as file:
        for key in () if given.summary else keys():
            if key not in rows:
                rows[key] = row(key)
                file.write(json.dumps(rows[key]) + "\n")
                file.flush()
    print("\n".join([*faults(rows), summary(rows)]), flush=True)


if __name__ == "__main__":
    main()
