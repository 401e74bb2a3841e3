"""The one door: success only for a loop that is stable for certain and meets everything on the process itself."""

from __future__ import annotations

import cmath
import math
from dataclasses import replace
from itertools import chain, repeat

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fopid_core.design.tuner import Bound, TuningRequest, TuningResult, tune
from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.loop import Loop
from fopid_core.model.margins import margins
from fopid_core.model.process import Process, read_process
from fopid_core.model.stability import stability
from tests.cases import slow

P1 = read_process("P1")


def papers_request(process: str = "P1", crossover: float = 0.3) -> TuningRequest:
    return TuningRequest(
        read_process(process),
        phase_margin=math.radians(80.0),
        crossover=crossover,
        t_max=Bound(-40.0, 10.0),
        s_max=Bound(-40.0, 0.01),
    )


def holds_what_it_promises(request: TuningRequest, result: TuningResult) -> bool:
    """Whether a result is consistent, and a controller handed out is stable on the process itself."""
    if result.controller is None:
        return not result.success and not result.stable
    verdict = stability(Loop(request.process, result.controller))
    return verdict.stable and verdict.decided and result.stable and result.success == (not result.unmet)


@pytest.mark.long
@settings(derandomize=True, deadline=None, max_examples=25)
@given(
    poles=st.lists(st.floats(0.05, 20.0), min_size=1, max_size=3),
    delay=st.floats(0.0, 3.0),
    integrating=st.booleans(),
    gain=st.floats(0.1, 10.0),
    method=st.sampled_from(["frequency", "time", "rule"]),
)
def test_no_controller_is_handed_out_whose_loop_is_not_stable(
    poles: list[float], delay: float, integrating: bool, gain: float, method: str
) -> None:
    lags = "".join(f"({pole!r}s+1)" for pole in poles) + ("s" if integrating else "")
    request = TuningRequest(Process.parse(f"{gain!r}/({lags})*exp(-{delay!r}s)"), method=method)
    try:
        result = tune(request)
    except InputError:
        assert method == "rule"
        assert integrating
        return
    assert holds_what_it_promises(request, result)


@pytest.mark.parametrize("method", ["frequency", "time", "rule"])
@pytest.mark.parametrize("process", ["P2", *slow("P1", "P3", "P4")])
def test_with_nothing_specified_the_test_bench_is_tuned_by_every_method(process: str, method: str) -> None:
    request = TuningRequest(read_process(process), method=method)
    result = tune(request)
    assert result.success, result
    assert holds_what_it_promises(request, result)
    assert result.achieved is not None
    assert result.achieved.ms < 2.5
    assert "default" in result.message


def test_what_was_chosen_is_said() -> None:
    result = tune(TuningRequest(P1))
    assert result.achieved is not None
    assert f"crossover {result.achieved.crossover:.4g} rad/s chosen from the process" in result.message
    assert "phase margin 60 deg by default" in result.message
    assert "horizon chosen from the process" in tune(TuningRequest(P1, method="time")).message


def test_bounds_that_can_be_met_are_met() -> None:
    result = tune(papers_request("P2", 1.0))
    assert result.success
    assert result.achieved is not None
    assert result.achieved.phase_margin == pytest.approx(math.radians(80.0), abs=1e-6)
    assert result.achieved.crossover == pytest.approx(1.0, rel=1e-6)
    assert abs(result.achieved.phase_slope) < 1e-6
    assert result.achieved.t_db <= -40.0 + 1e-3
    assert result.achieved.s_db <= -40.0 + 1e-3


def test_bounds_out_of_reach_are_named_and_the_nearest_stable_design_is_given() -> None:
    result = tune(papers_request())
    assert not result.success
    assert result.stable
    assert result.controller is not None
    assert [text[:3] for text in result.unmet] == ["|T|", "|S|"]
    assert all("-40 dB" in text and "dB here" in text for text in result.unmet)


@pytest.mark.slow
def test_a_margin_out_of_reach_is_answered_with_the_nearest_one() -> None:
    """With this delay the lag of the process is more than gains of one sign can make up for."""
    result = tune(TuningRequest(Process.parse("1/(s+1)*exp(-s)"), phase_margin=math.radians(150.0), crossover=0.3))
    assert not result.success
    assert "phase margin 150 deg" in result.unmet[0]
    assert "nearest possible" in result.unmet[0]
    assert result.stable


def test_a_process_that_no_gains_of_one_sign_can_make_flat_has_the_margin_without_flatness() -> None:
    """The phase of 1/(s-1) rises, and so does that of every controller with positive parts."""
    result = tune(TuningRequest(Process.parse("1/(s-1)"), phase_margin=1.0, crossover=3.0))
    assert not result.success
    assert "at no phase margin is there a flat one" in result.unmet[0]
    loop = result.controller(3.0j) / (3.0j - 1.0)
    assert result.stable
    assert abs(loop - cmath.exp(1j * (1.0 - math.pi))) < 1e-9


@pytest.mark.parametrize("via", ["foptd", "soptd", "nioptd1", "nioptd2"])
def test_a_design_on_a_reduced_model_is_checked_on_the_process_itself(via: str) -> None:
    request = TuningRequest(P1, phase_margin=1.2, crossover=0.4, via=via)
    result = tune(request)
    assert holds_what_it_promises(request, result)
    assert via in result.message
    if result.controller is not None and result.achieved is not None:
        assert result.achieved.phase_margin == pytest.approx(margins(Loop(P1, result.controller)).phase_margin)


def test_the_better_the_model_the_nearer_the_design_on_it() -> None:
    off = {}
    for via in ("soptd", "nioptd2", "none"):
        result = tune(TuningRequest(P1, phase_margin=1.2, crossover=0.4, via=via))
        assert result.achieved is not None
        off[via] = abs(result.achieved.phase_margin - 1.2)
    assert off["none"] < 1e-9 < off["nioptd2"] < off["soptd"]


def test_a_bound_that_holds_on_the_model_only_is_named() -> None:
    """A first-order model knows nothing of the process's resonance."""
    process = Process.parse("9/((s+1)(s^2+0.6s+9))")
    result = tune(TuningRequest(process, phase_margin=1.4, crossover=0.25, t_max=Bound(-12.0, 2.0), via="foptd"))
    assert not result.success
    assert result.achieved is not None
    assert result.achieved.t_db > -12.0
    assert result.unmet == (f"|T| <= -12 dB at 2 rad/s: {result.achieved.t_db:.4g} dB on the process itself",)


@pytest.mark.parametrize("solver", ["paper", "monje"])
def test_the_published_methods_are_there_by_name(solver: str) -> None:
    request = replace(papers_request(), solver=solver)
    result = tune(request)
    assert holds_what_it_promises(request, result)
    assert solver in result.message


def test_a_timeout_gives_the_best_found_so_far_unsuccessfully() -> None:
    ticks = iter(np.arange(0.0, 1e4, 0.1))
    request = TuningRequest(P1, method="time", timeout=1.0)
    result = tune(request, clock=lambda: float(next(ticks)))
    assert not result.success
    assert result.controller is not None
    assert stability(Loop(P1, result.controller)).stable
    assert "timeout 1 s" in result.message


def test_elapsed_is_what_the_clock_says() -> None:
    ticks = chain([5.0], repeat(7.5))
    assert tune(TuningRequest(P1, method="rule"), clock=lambda: next(ticks)).elapsed == 2.5


@pytest.mark.parametrize("process", ["P1", "P2"])  # P2 takes a second round, on finer grids
def test_progress_goes_from_its_beginning_to_one(process: str) -> None:
    shares: list[float] = []
    tune(TuningRequest(read_process(process), method="time"), progress=lambda share, _: shares.append(share))
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_a_start_is_made_use_of() -> None:
    start = Fopid(1.2, 0.68, 0.9, 0.997, 0.63)
    result = tune(TuningRequest(P1, method="time", start=start, horizon=50.0))
    assert result.success


def test_an_index_that_does_not_exist_is_answered() -> None:
    """Without an integral the error of P1 does not die out: the index grows with the horizon, and that is said."""
    result = tune(TuningRequest(P1, method="time", fixed={"ki": 0.0}))
    assert "does not die out" in result.message


@pytest.mark.parametrize(
    ("request_", "message"),
    [
        (TuningRequest(Process.parse("1/(s+1)*exp(-5s)"), method="time", horizon=4.0), "horizon = 4 s; allowed"),
        (TuningRequest(P1, method="time", index="best"), "index = 'best'"),
        (TuningRequest(P1, solver="paper", phase_margin=1.0, crossover=1.0), "t_max = None"),
        (TuningRequest(Process.parse("(s^2+1)/(s+1)^4"), phase_margin=1.0, crossover=1.0), "crossover 1 rad/s"),
        (TuningRequest(Process.parse("1/s"), method="rule", rule="fmigo"), "not stable"),
        (TuningRequest(Process.parse("1/s"), via="foptd"), "not stable"),
    ],
)
def test_what_a_method_cannot_use_is_refused(request_: TuningRequest, message: str) -> None:
    with pytest.raises(InputError) as error:
        tune(request_)
    assert message in str(error.value)


@pytest.mark.parametrize(
    ("process", "options"),
    [
        pytest.param("1/(s(s^2+0.001s+1))", {}, marks=pytest.mark.slow),
        pytest.param("1/(s+1)*exp(-20s)", {}, marks=pytest.mark.slow),
        pytest.param(
            "50/(s^2-900)",
            {"horizon": 0.5, "sample_time": 0.001, "ms_max": 2.0, "u_max": 3000.0},
            marks=pytest.mark.slow,
        ),
        ("P2", {"ms_max": 1.4, "noise_max": 10.0}),
    ],
)
def test_a_success_keeps_every_bound_at_every_frequency(process: str, options: dict[str, float]) -> None:
    """By brute force on eighty thousand frequencies, many of them about the resonance at 1 rad/s."""
    request = TuningRequest(read_process(process), method="time", **options)  # type: ignore[arg-type]
    result = tune(request)
    assert result.success, result.unmet
    assert result.controller is not None
    w = np.concatenate([np.geomspace(1e-5, 1e5, 60_001), 1.0 + np.linspace(-0.01, 0.01, 20_001)])
    loop = result.controller(1j * w) * request.process(1j * w)
    assert np.max(1.0 / np.abs(1.0 + loop)) <= (request.ms_max or 1.6) * (1.0 + 1e-6)
    inside = w < math.pi / request.sample_time
    noise = np.abs(result.controller(1j * w) / (1.0 + loop))[inside].max()
    assert noise <= (request.noise_max or math.inf) * (1.0 + 1e-6)


@pytest.mark.parametrize("process", ["P4", "0.2/(4.5s+1)*exp(-0.79s)", *slow("P1", "P2", "P3")])
def test_with_nothing_specified_no_part_of_the_controller_is_one_that_few_would_trust(process: str) -> None:
    """P4 had kp of 0.002 beside ki of 13, and a derivative of order 0.33."""
    found = tune(TuningRequest(read_process(process), method="frequency"))
    assert found.success, found.message
    gains, w = found.controller, found.achieved.crossover
    assert 0.7 <= gains.lam <= 1.3
    assert 0.5 <= gains.mu <= 1.5
    assert abs(gains.kp) >= 0.1 * abs(complex(gains(1j * w)))


@pytest.mark.slow
def test_in_time_a_practical_controller_may_cost_a_tenth_and_where_it_costs_more_that_is_said() -> None:
    found = tune(TuningRequest(Process.parse("1/s^2"), method="time"))
    assert found.controller.kp > 0.1
    assert "a fopid with kp and orders off their edges preferred" in found.message
    dear = tune(TuningRequest(Process.parse("3/(s(0.247s+1))"), method="time"))
    assert "few would trust it: a fopid with kp and orders off their edges costs" in dear.message
