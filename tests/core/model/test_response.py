"""Responses are exact to 1e-5, whatever the process, and say so themselves.

Oracles, none of which shares code with the inversion: de Hoog's method in mpmath with the formulas written out; for a
delay the method of steps, a finite sum of delay-free inversions; matrix exponentials at integer orders, where a
response may ring or grow for long; Mittag-Leffler functions for fractional integrators.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import mpmath as mp
import numpy as np
import pytest
import scipy.signal
from hypothesis import given, settings
from hypothesis import strategies as st

from fopid_core.data import paper_tables
from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.indices import indices
from fopid_core.model.loop import Loop
from fopid_core.model.process import Process, read_process
from fopid_core.model.response import Response, Source, step_response

WANTED = 1e-5
Transform = Callable[[mp.mpf], mp.mpf]


@dataclass(frozen=True)
class Case:
    name: str
    process: str
    plain: Transform  # the process without its delay, as a formula for mpmath
    delay: float
    gains: tuple[float, float, float, float, float]
    horizon: float

    @property
    def loop(self) -> Loop:
        return Loop(read_process(self.process), Fopid(*self.gains))

    def controller(self, s: mp.mpf) -> mp.mpf:
        kp, ki, kd, lam, mu = (mp.mpf(g) for g in self.gains)
        return kp + ki * s**-lam + kd * s**mu


def m(value: float) -> mp.mpf:
    return mp.mpf(value)


CASES = [
    Case("P1", "P1", lambda s: 1 / (s + 1) ** 3, 0, (2.9692, 0.8028, 1.3394, 1.0138, 0.6074), 30),
    Case("order 10", "1/(s+1)^10", lambda s: 1 / (s + 1) ** 10, 0, (0.8, 0.1, 1.0, 1.05, 0.9), 100),
    Case(
        "non-minimum phase", "(1-0.5s)/((s+1)(2s+1))", lambda s: (1 - s / 2) / ((s + 1) * (2 * s + 1)), 0,
        (0.8, 0.3, 0.2, 0.9, 0.7), 40,
    ),
    Case(
        "fractional", "1/(0.8s^2.2+0.5s^0.9+1)", lambda s: 1 / (m(0.8) * s ** m(2.2) + s ** m(0.9) / 2 + 1), 0,
        (0.5, 0.5, 0.6, 1.1, 0.8), 12,
    ),
    Case(
        "fractional, many terms", "(s^0.3+2)/(s^1.7+0.5s^1.1+s^0.4+1)",
        lambda s: (s ** m(0.3) + 2) / (s ** m(1.7) + s ** m(1.1) / 2 + s ** m(0.4) + 1), 0, (1, 0.5, 0.3, 0.7, 0.5), 20,
    ),
    Case("integrating", "1/(s(s+1))", lambda s: 1 / (s * (s + 1)), 0, (1.0, 0.1, 0.5, 0.5, 0.8), 40),
    Case("twice integrating", "1/s^2", lambda s: 1 / s**2, 0, (1.0, 0.1, 1.5, 0.5, 1.0), 40),
    Case("unstable", "2/(s-1)", lambda s: 2 / (s - 1), 0, (2.0, 1.0, 0.1, 0.9, 0.5), 20),
    Case("biproper", "(s+2)/(s+1)", lambda s: (s + 2) / (s + 1), 0, (1.0, 0.5, 0.0, 1.0, 1.0), 20),
    Case("jump at once", "1/(s+1)", lambda s: 1 / (s + 1), 0, (1.0, 0.5, 0.5, 1.0, 1.0), 20),
    Case("mu above the relative degree", "1/(s+1)", lambda s: 1 / (s + 1), 0, (1.0, 0.5, 0.5, 1.0, 1.4), 20),
    Case("delay", "1/(s+1)*exp(-1s)", lambda s: 1 / (s + 1), 1, (0.6, 0.5, 0.2, 0.9, 0.5), 20),
    Case("delay and jumps", "1/(s+1)*exp(-1s)", lambda s: 1 / (s + 1), 1, (0.3, 0.5, 0.5, 0.9, 1.0), 20),
    Case("delay and cusps", "1/(s+1)*exp(-1s)", lambda s: 1 / (s + 1), 1, (0.3, 0.5, 0.3, 0.9, 0.9), 20),
    Case(
        "slow", "3.13/(433.33s+1)*exp(-50s)", lambda s: m(3.13) / (m(433.33) * s + 1), 50,
        (1.5, 0.005, 20.0, 0.9, 0.8), 1000,
    ),
    Case("integrating, delay", "0.5/s*exp(-0.5s)", lambda s: m(0.5) / s, 0.5, (1.0, 0.1, 0.1, 1.1, 0.3), 10),
    Case("unstable, delay", "1/(s-1)*exp(-0.2s)", lambda s: 1 / (s - 1), 0.2, (2.0, 0.3, 0.1, 1.0, 0.5), 4),
    Case(
        "fractional, delay", "1/(0.8s^2.2+0.5s^0.9+1)*exp(-0.3s)",
        lambda s: 1 / (m(0.8) * s ** m(2.2) + s ** m(0.9) / 2 + 1), 0.3, (0.3, 0.3, 0.3, 1.1, 0.6), 6,
    ),
]  # fmt: skip


def invert(transform: Transform, time: float) -> float:
    with mp.workdps(25):
        return float(mp.invertlaplace(transform, mp.mpf(time), method="dehoog", degree=28))


def expected(case: Case, source: Source, time: float) -> tuple[float, float]:
    """Output and control at one instant."""
    c, p, delay = case.controller, case.plain, case.delay
    if not delay:
        if source == "setpoint":
            return (
                invert(lambda s: c(s) * p(s) / (1 + c(s) * p(s)) / s, time),
                invert(lambda s: c(s) / (1 + c(s) * p(s)) / s, time),
            )
        return (
            invert(lambda s: p(s) / (1 + c(s) * p(s)) / s, time),
            invert(lambda s: -c(s) * p(s) / (1 + c(s) * p(s)) / s, time),
        )
    return method_of_steps(case, source, time)


def method_of_steps(case: Case, source: Source, time: float) -> tuple[float, float]:
    """1 / (1 + L exp(-s d)) = sum of (-L)^k exp(-k s d), of which only k d < t has arrived."""
    c, p = case.controller, case.plain
    output = control = 0.0
    for k in range(math.ceil(time / case.delay)):
        now, later = time - k * case.delay, time - (k + 1) * case.delay
        if source == "setpoint":
            control += invert(lambda s, k=k: c(s) * (-c(s) * p(s)) ** k / s, now)
            output += invert(lambda s, k=k: -((-c(s) * p(s)) ** (k + 1)) / s, later) if later > 0.0 else 0.0
        elif later > 0.0:
            output += invert(lambda s, k=k: p(s) * (-c(s) * p(s)) ** k / s, later)
            control += invert(lambda s, k=k: (-c(s) * p(s)) ** (k + 1) / s, later)
    return output, control


def check(case: Case, source: Source, shares: tuple[float, ...]) -> None:
    response = step_response(case.loop, case.horizon, source, points=1001)
    for i in (round(1000 * share) for share in shares):
        output, control = expected(case, source, float(response.time[i]))
        assert response.output[i] == pytest.approx(output, abs=WANTED)
        assert response.control[i] == pytest.approx(control, abs=WANTED, rel=WANTED)
        assert response.output[i] == pytest.approx(output, abs=10.0 * response.accuracy)
    assert response.error == pytest.approx((1.0 if source == "setpoint" else 0.0) - response.output)
    assert max(response.accuracy, response.control_accuracy) <= WANTED


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_a_setpoint_response_is_exact(case: Case) -> None:
    check(case, "setpoint", (0.003, 0.061, 0.253))


@pytest.mark.parametrize("case", CASES[::3], ids=lambda case: case.name)
def test_a_load_response_is_exact(case: Case) -> None:
    check(case, "load", (0.003, 0.061, 0.203))


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
@pytest.mark.parametrize("source", ["setpoint", "load"])
def test_responses_are_exact_at_many_instants(case: Case, source: Source) -> None:
    check(case, source, (0.001, 0.002, 0.01, 0.049, 0.051, 0.099, 0.101, 0.153, 0.333, 0.503))


@pytest.mark.parametrize(
    ("text", "gains", "horizon"),
    [
        ("1/(s^2+0.02s+1)", (0.2, 0.1, 0.1), 200.0),
        ("4/((s+1)(s^2+0.01s+4))", (0.008, 0.002, 0.01), 500.0),
        ("P1", (12.0, 1.0, 0.0), 30.0),
        ("1/(s-1)", (0.5, 0.1, 0.0), 20.0),
        ("1/((s+1)(0.001s+1))", (3.0, 1.0, 0.2), 50.0),
        ("P4", (3.0, 3.0, 0.5), 50.0),
    ],
    ids=["resonant loop", "resonant process", "growing oscillation", "growing", "stiff", "P4"],
)
def test_at_integer_orders_it_is_the_matrix_exponential(
    text: str, gains: tuple[float, float, float], horizon: float
) -> None:
    process = read_process(text)
    kp, ki, kd = gains
    numerator, denominator, _ = process.polynomials()
    forward = np.polymul([kd, kp, ki], numerator)
    closed = np.polyadd(np.polymul([1.0, 0.0], denominator), forward)
    response = step_response(Loop(process, Fopid(kp, ki, kd)), horizon, points=401)
    _, exact, _ = scipy.signal.lsim((forward, closed), np.ones(401), response.time)
    assert response.output == pytest.approx(exact, abs=WANTED * max(1.0, float(np.max(np.abs(exact)))))


@settings(derandomize=True, deadline=None, max_examples=8)
@given(st.floats(0.3, 1.7), st.floats(0.2, 2.0))
def test_a_fractional_integrator_answers_with_a_mittag_leffler_function(alpha: float, gain: float) -> None:
    loop = Loop(Process.parse(f"1/s^{alpha!r}"), Fopid(gain))
    response = step_response(loop, 2.0, points=11)
    exact = [1.0 - mittag_leffler(alpha, -gain * t**alpha) for t in response.time]
    assert response.output == pytest.approx(exact, abs=WANTED)


def mittag_leffler(alpha: float, x: float) -> float:
    with mp.workdps(60):
        return float(mp.nsum(lambda k: mp.mpf(x) ** k / mp.gamma(mp.mpf(alpha) * k + 1), [0, 150], method="d"))


@pytest.mark.parametrize("row", paper_tables()["table4_to_7"], ids=lambda r: f"{r['process']} {r['index']}")
def test_the_exact_indices_of_the_papers_controllers(row: dict[str, object]) -> None:
    loop = Loop(read_process(row["process"]), Fopid(*(row[name] for name in ("kp", "ki", "kd", "lam", "mu"))))
    response = step_response(loop, 50.0)
    found, name = indices(response.time, response.error), row["index"].lower()
    value = found.weighted_sum() if name == "sum" else getattr(found, name)
    assert value == pytest.approx(row["exact"]["J"], rel=1e-3, abs=1e-4)


def test_an_index_does_not_depend_on_the_number_of_points_asked_for() -> None:
    # the loop of P4 with the paper's ISE gains rises in 0.01 s: 5 million even points against the chosen ones
    loop = Loop(read_process("P4"), Fopid(28.9897, 32.6211, 22.3986, 0.333, 1.6265))
    chosen, even = step_response(loop, 50.0), step_response(loop, 50.0, points=1_000_001)
    assert chosen.time.size < 50_000
    assert indices(chosen.time, chosen.error).ise == pytest.approx(indices(even.time, even.error).ise, rel=1e-3)


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_loop_that_rings_fast_on_a_long_horizon_is_exact_from_its_first_instants() -> None:
    # de Hoog's method needs degree 120 and 130 digits to see 205 rad/s for so long
    kp, ki, kd, lam, mu = (mp.mpf(g) for g in (28.9897, 32.6211, 22.3986, 0.333, 1.6265))
    response = step_response(Loop(read_process("P4"), Fopid(*map(float, (kp, ki, kd, lam, mu)))), 50.0)
    with mp.workdps(130):

        def transform(s: mp.mpf) -> mp.mpf:
            forward = kp + ki * s**-lam + kd * s**mu
            lags = (s + 1) * (s / 5 + 1) * (s / 25 + 1) * (s / 125 + 1)
            return forward / (lags + forward) / s

        for time in (0.002, 0.011, 0.02, 0.05, 0.2, 1.0, 10.0, 50.0):
            i = int(np.argmin(np.abs(response.time - time)))
            exact = mp.invertlaplace(transform, mp.mpf(float(response.time[i])), method="dehoog", degree=120)
            assert response.output[i] == pytest.approx(float(exact), abs=WANTED)


def test_jumps_are_shown_after_the_jump_and_do_not_ring() -> None:
    # L = 0.5 s exp(-s) / (s + 1) jumps to 0.5 at t = 1, and its echoes by powers of 0.5 at every further second
    loop = Loop(Process.parse("1/(s+1)*exp(-1s)"), Fopid(0.0, 0.0, 0.5))
    response = step_response(loop, 6.0, points=6001)
    at = {t: round(1000 * t) for t in (1, 2, 3)}
    assert response.output[at[1] - 1] == pytest.approx(0.0, abs=WANTED)
    assert response.output[at[1]] == pytest.approx(0.5, abs=WANTED)
    jump = response.output[at[2]] - response.output[at[2] - 1]
    assert jump == pytest.approx(-0.25, abs=1e-3)
    between = response.time[at[1] : at[2]] - 1.0
    assert response.output[at[1] : at[2]] == pytest.approx(0.5 * np.exp(-between), abs=WANTED)


def test_the_kick_of_an_ideal_derivative_is_infinite_and_left_out_of_the_samples() -> None:
    def control(mu: float) -> Response:
        return step_response(Loop(Process.parse("1/(s+1)^2"), Fopid(1.0, 0.0, 0.3, 1.0, mu)), 5.0)

    half, one, more, none = control(0.5), control(1.0), control(1.4), control(0.0)
    assert (half.control[0], half.control_impulse, half.control_peak) == (math.inf, 0.0, math.inf)
    assert one.control_impulse == pytest.approx(0.3)
    assert math.isfinite(one.control[0])
    assert one.control_peak == math.inf
    assert (more.control_impulse, more.control_peak) == (math.inf, math.inf)
    assert none.control_peak == pytest.approx(1.3)
    # u -> kd t^-mu / Gamma(1 - mu) + kp as t -> 0
    t = half.time[3]
    assert half.control[3] == pytest.approx(0.3 * t**-0.5 / math.gamma(0.5) + 1.0, rel=1e-2)


def test_the_final_value_is_that_of_the_loop() -> None:
    response = step_response(Loop(read_process("P1"), Fopid(3.0)), 60.0, points=11)
    assert response.output[-1] == pytest.approx(0.75, abs=WANTED)
    load = step_response(Loop(read_process("P1"), Fopid(3.0, 1.0)), 100.0, "load", points=11)
    assert (load.output[-1], load.control[-1]) == pytest.approx((0.0, -1.0), abs=WANTED)


@settings(derandomize=True, deadline=None, max_examples=10)
@given(st.floats(0.5, 3.0), st.floats(0.1, 1.0), st.just(0.0) | st.floats(1e-200, 1.0), st.floats(0.3, 1.5),
       st.floats(0.2, 1.5))  # fmt: skip
def test_process_and_controller_may_share_a_gain_in_any_way(
    kp: float, ki: float, kd: float, lam: float, mu: float
) -> None:
    whole = step_response(Loop(read_process("P1"), Fopid(kp, ki, kd, lam, mu)), 20.0, points=101)
    halved = Loop(read_process("P1").scaled(0.5), Fopid(2 * kp, 2 * ki, 2 * kd, lam, mu))
    assert step_response(halved, 20.0, points=101).output == pytest.approx(whole.output, abs=WANTED)


def test_without_a_number_of_points_the_times_rise_from_zero_to_the_horizon() -> None:
    response = step_response(Loop(read_process("P4"), Fopid(28.9897, 32.6211, 22.3986, 0.333, 1.6265)), 50.0)
    assert response.time[0] == 0.0
    assert response.time[-1] == 50.0
    assert np.all(np.diff(response.time) > 0.0)
    assert response.output[0] == pytest.approx(0.0, abs=WANTED)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ({"horizon": 0.0}, "horizon = 0.0; allowed: 1e-12"),
        ({"horizon": math.nan}, "horizon = nan"),
        ({"horizon": 10.0, "source": "noise"}, "source = 'noise'; allowed: setpoint, load"),
        ({"horizon": 10.0, "points": 1}, "points = 1; allowed: at least 2"),
    ],
)
def test_bad_arguments_are_refused(arguments: dict[str, object], reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        step_response(Loop(read_process("P1"), Fopid(1.0)), **arguments)  # type: ignore[arg-type]


def test_a_horizon_on_which_nothing_arrives_is_refused() -> None:
    loop = Loop(Process.parse("1/(s+1)*exp(-5s)"), Fopid(1.0))
    with pytest.raises(InputError, match=r"horizon = 4.0; allowed: longer than the process's delay of 5 s"):
        step_response(loop, 4.0)


def test_a_loop_without_a_response_is_refused_with_the_reason() -> None:
    with pytest.raises(InputError, match=r"mu = 1.2 .* allowed: at most the relative degree"):
        step_response(Loop(Process.parse("1/(s+1)*exp(-1s)"), Fopid(1.0, 0.0, 0.1, 1.0, 1.2)), 10.0)


def test_a_loop_that_grows_beyond_all_numbers_is_refused() -> None:
    with pytest.raises(InputError, match=r"grows by more than exp\(600\)"):
        step_response(Loop(Process.parse("1/(s-10)"), Fopid(1.0)), 1000.0)
