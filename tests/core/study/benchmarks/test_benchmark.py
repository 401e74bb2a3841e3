"""The benchmark measures what it says; no test here depends on how fast this machine is."""

from __future__ import annotations

import json

import control
import numpy as np
import pytest

from fopid_core.model.fopid import Fopid
from fopid_core.model.indices import indices
from fopid_core.model.loop import Loop
from fopid_core.model.process import read_process
from fopid_core.model.response import step_response
from fopid_core.study.benchmarks.baseline import closed_loop, fractional_power, itae, tune_itae
from fopid_core.study.benchmarks.benchmark import GAINS
from fopid_core.study.benchmarks.figure import Figure, best_time

from ...cli.runner import invoke


def test_the_ratio_is_how_many_times_faster() -> None:
    figure = Figure("name", 2.0, "ms", 50.0, "another", "right to a hair")
    assert figure.ratio == 25.0
    assert str(figure) == "2 ms (50 ms with another: 25 times); right to a hair"
    assert Figure("name", 2.0, "ms").ratio is None


def test_the_best_time_is_that_of_the_work() -> None:
    calls: list[int] = []
    assert best_time(lambda: calls.append(1), repeats=7) >= 0.0
    assert len(calls) == 7


@pytest.mark.parametrize("order", [-0.8, -0.3, 0.5, 0.9])
def test_the_baselines_fractional_power_is_one_on_its_band(order: float) -> None:
    w = np.geomspace(0.1, 10.0, 20)
    values = np.array([fractional_power(order)(1j * x) for x in w])
    assert np.allclose(values, (1j * w) ** order, rtol=0.1)


def test_the_baseline_is_a_fair_one() -> None:
    """Its index of the benchmark's loop is right to 0.1 %, and it grows no unstable loop."""
    process = control.ss(control.tf([1.0], [1.0, 3.0, 3.0, 1.0]))
    response = step_response(Loop(read_process("P1"), Fopid(*GAINS)), 50.0)
    exact = indices(response.time, response.error).itae
    assert itae(process, GAINS, 50.0) == pytest.approx(exact, rel=1e-3)
    assert closed_loop(process, GAINS).poles().real.max() < 0.0


def test_the_baselines_tuning_keeps_the_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    import fopid_core.study.benchmarks.baseline as baseline

    def short(*args: object, **kwargs: object) -> object:
        kwargs["options"] = {"maxfev": 40}
        return original(*args, **kwargs)

    original = baseline.minimize
    monkeypatch.setattr(baseline, "minimize", short)
    process = control.ss(control.tf([1.0], [1.0, 3.0, 3.0, 1.0]))
    gains, evaluations = tune_itae(process, 50.0, 1.6, 20.0, 0.01, start=(1.0, 0.3, 0.1, 1.0, 0.9))
    assert 0 < evaluations <= 45
    s = 1j * np.geomspace(1e-3, 1e3, 2000)
    kp, ki, kd, lam, mu = gains
    assert (1 / np.abs(1 + (kp + ki * s**-lam + kd * s**mu) / (s + 1) ** 3)).max() < 1.62


@pytest.mark.long
@pytest.mark.timeout(900)
def test_every_figure_of_the_performance_table_is_measured() -> None:
    result = invoke(["benchmark", "--quick", "--json"])
    assert result.exit_code == 0
    figures = json.loads(result.stdout)["figures"]
    names = " ".join(figure["name"] for figure in figures)
    for part in ("response with ITAE", "bare FFT", "ITAE tuning of P1", "frequency-domain", "reduction", "stability",
                 "horizon", "order", "at once", "import"):  # fmt: skip
        assert part in names
    assert all(figure["value"] > 0.0 for figure in figures)
