"""The gains as control systems take them: parallel, standard (ISA) and series form."""

from __future__ import annotations

import math
from dataclasses import dataclass

from fopid_core.errors import InputError
from fopid_core.model.fopid import Fopid

_ROUNDING = 1e-12  # of Ti = 4 Td, the double zero


@dataclass(frozen=True)
class PidForm:
    """A gain, an integral time and a derivative time.

    Attributes
    ----------
    gain : float
        [control unit / measurement unit]
    integral_time, derivative_time : float
        Ti and Td [s]; infinite and 0 without that action. With orders other than 1 the times at which the parts are as
        large as the proportional one: C = K (1 + (Ti s)^-lam + (Td s)^mu).
    """

    gain: float
    integral_time: float
    derivative_time: float

    @property
    def proportional_band(self) -> float:
        """100 over the gain, which is of per cent to per cent [%]."""
        return 100.0 / self.gain


def standard_form(controller: Fopid) -> PidForm:
    """K (1 + (Ti s)^-lam + (Td s)^mu), the ideal or ISA form.

    Examples
    --------
    >>> standard_form(Fopid(kp=2.0, ki=0.5, kd=1.0))
    PidForm(gain=2.0, integral_time=4.0, derivative_time=0.5)
    """
    kp, ki, kd, lam, mu = controller.gains
    if kp == 0.0 or min(ki / kp, kd / kp) < 0.0:
        raise InputError(f"kp = {kp:g}, ki = {ki:g}, kd = {kd:g}; allowed: gains of one sign, kp not 0")
    if (ki and lam == 0.0) or (kd and mu == 0.0):
        raise InputError(f"lam = {lam:g}, mu = {mu:g}; allowed: orders above 0")
    integral = (kp / ki) ** (1.0 / lam) if ki else math.inf
    return PidForm(kp, integral, (kd / kp) ** (1.0 / mu) if kd else 0.0)


def series_form(controller: Fopid) -> PidForm:
    """K (1 + 1/(Ti s)) (1 + Td s), as pneumatic and many digital controllers take it.

    Raises
    ------
    InputError
        With orders other than 1, and where the zeros of the controller are complex (Ti < 4 Td in standard form).

    Examples
    --------
    >>> series_form(Fopid(kp=2.5, ki=0.5, kd=2.0))
    PidForm(gain=2.0, integral_time=4.0, derivative_time=1.0)
    """
    standard = standard_form(controller)
    if (controller.ki and controller.lam != 1.0) or (controller.kd and controller.mu != 1.0):
        raise InputError(f"lam = {controller.lam:g}, mu = {controller.mu:g}; allowed: orders of 1")
    if math.isinf(standard.integral_time):
        return standard
    ratio = 4.0 * standard.derivative_time / standard.integral_time
    if ratio > 1.0 + _ROUNDING:
        raise InputError(
            f"Ti = {standard.integral_time:.4g}, Td = {standard.derivative_time:.4g}; allowed: Ti of at least 4 Td"
        )
    share = 0.5 * (1.0 + math.sqrt(max(1.0 - ratio, 0.0)))
    return PidForm(standard.gain * share, standard.integral_time * share, standard.derivative_time / share)
