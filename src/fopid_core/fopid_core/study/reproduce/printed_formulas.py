"""Eqs. (18) to (22) letter by letter as the paper prints them, to be held against what they should be.

All take the frequency w [rad/s]; c is 2 zeta omega_n and a is omega_n^2.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from fopid_core.model.fopid import Fopid


def model_phase(model: Mapping[str, float], w: float) -> float:
    """Arg P(jw) of NIOPTD-II [rad], eq. (18)."""
    real, imag = _denominator(model, w)
    return -w * model["L"] - math.atan(imag / real)


def model_phase_slope(model: Mapping[str, float], w: float) -> float:
    """Slope d Arg P / dw of NIOPTD-II [rad s], eq. (19)."""
    c, a, alpha, beta = model["a1"], model["a0"], model["alpha"], model["beta"]
    real, imag = _denominator(model, w)
    numerator: float = (
        c * (alpha - beta) * w ** (alpha + beta - 1.0) * math.sin((alpha - beta) * math.pi / 2.0)
        - alpha * a * w ** (alpha - 1.0) * math.sin(alpha * math.pi / 2.0)
        - beta * c * a * w ** (beta - 1.0) * math.sin(beta * math.pi / 2.0)
    )
    return -model["L"] - numerator / (real**2 + imag**2)


def _denominator(model: Mapping[str, float], w: float) -> tuple[float, float]:
    """Real and imaginary part of the model's denominator, as they stand in eqs. (17) to (19)."""
    first, second = w ** model["alpha"], model["a1"] * w ** model["beta"]
    turn, other_turn = model["alpha"] * math.pi / 2.0, model["beta"] * math.pi / 2.0
    real = first * math.cos(turn) + second * math.cos(other_turn) + model["a0"]
    return real, first * math.sin(turn) + second * math.sin(other_turn)


def controller_gain(controller: Fopid, w: float) -> float:
    """|C(jw)|, eq. (20)."""
    return math.hypot(*_controller(controller, w))


def controller_phase(controller: Fopid, w: float) -> float:
    """Arg C(jw) [rad], eq. (21)."""
    real, imag = _controller(controller, w)
    return math.atan(imag / real)


def controller_phase_slope(controller: Fopid, w: float) -> float:
    """Slope d Arg C / dw [rad s], eq. (22)."""
    kp, ki, kd, lam, mu = controller.gains
    real, imag = _controller(controller, w)
    numerator: float = (
        kp * kd * mu * w ** (mu - 1.0) * math.sin(mu * math.pi / 2.0)
        + kp * ki * lam * w ** (-lam - 1.0) * math.sin(lam * math.pi / 2.0)
        + ki * kd * (lam + mu) * w ** (mu - lam - 1.0) * math.sin((lam + mu) * math.pi / 2.0)
    )
    return numerator / (real**2 + imag**2)


def _controller(controller: Fopid, w: float) -> tuple[float, float]:
    """Real and imaginary part of C(jw) as printed: with a cosine where the latter needs a sine."""
    kp, ki, kd, lam, mu = controller.gains
    integral, derivative = ki * w**-lam, kd * w**mu
    cosine = math.cos(lam * math.pi / 2.0)
    real = kp + integral * cosine + derivative * math.cos(mu * math.pi / 2.0)
    return real, derivative * math.sin(mu * math.pi / 2.0) - integral * cosine
