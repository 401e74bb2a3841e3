"""The region of stabilising gains is the known one, and its border is where the verdict changes."""

from __future__ import annotations

import numpy as np
import pytest

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process, read_process
from fopid_core.model.stability_region import stability_region


def test_pi_control_of_three_lags_has_rouths_region() -> None:
    # s^4 + 3 s^3 + 3 s^2 + (1 + kp) s + ki: Routh gives 0 < ki < (1 + kp) (8 - kp) / 9
    region = stability_region(read_process("P1"), Fopid(0.0), box=((-2.0, 9.0), (-1.0, 3.0)), resolution=45)
    kp, ki = np.meshgrid(region.x, region.y)
    limit = (1.0 + kp) * (8.0 - kp) / 9.0
    clear = (np.abs(ki) > 1e-6) & (np.abs(ki - limit) > 1e-6)
    assert np.array_equal(region.stable[clear], ((ki > 0.0) & (ki < limit))[clear])


def test_its_curve_is_the_solution_on_the_axis() -> None:
    region = stability_region(read_process("P1"), Fopid(0.0))
    kp, ki = region.curve
    inside = (kp > -0.99) & (kp < 7.99)
    assert ki[inside] == pytest.approx((1.0 + kp[inside]) * (8.0 - kp[inside]) / 9.0, rel=1e-9)
    assert region.border[inside].all()
    assert not region.border[ki < -0.1].any()


@pytest.mark.parametrize("lam", [0.6, 1.3])
def test_every_point_of_the_curve_puts_a_pole_on_the_axis(lam: float) -> None:
    process = Process.parse("1/(s^1.2+1)*exp(-0.5s)")
    region = stability_region(process, Fopid(0.0, 0.0, 0.2, lam, 0.7))
    for w, (kp, ki) in zip(region.frequency[::100], region.curve.T[::100], strict=True):
        loop_gain = (kp + ki * (1j * w) ** -lam + 0.2 * (1j * w) ** 0.7) * complex(process(1j * w))
        assert loop_gain == pytest.approx(-1.0, abs=1e-9)


def test_the_plane_of_kp_and_kd_is_there_too() -> None:
    # 1/s^2 with PD: s^2 + kd s + kp
    region = stability_region(Process.parse("1/s^2"), Fopid(0.0), ("kp", "kd"), ((-1.0, 1.0), (-1.0, 1.0)), 10)
    kp, kd = np.meshgrid(region.x, region.y)
    assert np.array_equal(region.stable, (kp > 0.0) & (kd > 0.0))


@pytest.mark.parametrize("text", ["P1", "1/(s+1)*exp(-1s)", "1/(s-1)*exp(-0.3s)", "1/(s+1)", "1/s"])
def test_without_a_box_the_region_is_in_view(text: str) -> None:
    region = stability_region(read_process(text), Fopid(0.0))
    assert 0.05 < region.stable.mean() < 0.95


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        ({"plane": ("kp", "kp")}, "allowed: two of kp, ki, kd"),
        ({"controller": Fopid(0.0, lam=2.0)}, "lam = 2"),
        ({"controller": Fopid(0.0, lam=0.0)}, "lam = 0"),
        ({"box": ((1.0, 0.0), (0.0, 1.0))}, "rising ranges"),
        ({"resolution": 1}, "resolution = 1"),
    ],
)
def test_regions_that_do_not_exist_are_refused(arguments: dict[str, object], reason: str) -> None:
    with pytest.raises(InputError, match=reason):
        stability_region(read_process("P1"), **({"controller": Fopid(0.0)} | arguments))  # type: ignore[arg-type]
