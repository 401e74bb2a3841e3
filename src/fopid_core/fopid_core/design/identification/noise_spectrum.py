"""At which frequencies a sensor's noise is: what it makes of the control depends on that, not only on its level."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.signal import detrend, welch

from fopid_core.design.identification.quality import whiteness
from fopid_core.model.arrays import Floats

LONGEST = 1024
"""Samples of a stretch that is looked at in one piece; longer ones in pieces that overlap by half."""
COLOURED = 1e-4
"""Noise passes for white unless chance alone would make it less white in fewer than so many cases."""
_WANDERS = 4
"""What comes back fewer times than that in a stretch is no noise that anybody knows: a drift, a transient's end."""
_FASTER = 0.95


@dataclass(frozen=True)
class NoiseSpectrum:
    """Where the variance of a noise is.

    Attributes
    ----------
    frequency : tuple of float
        [rad/s]
    share : tuple of float
        Of the variance about each; they sum to one.
    sample_time : float
        At which it was seen [s].
    """

    frequency: tuple[float, ...]
    share: tuple[float, ...]
    sample_time: float

    def angles(self, sample_time: float) -> Floats | None:
        """The frequencies of it that a controller with this tick [s] sees [rad], shape (n,).

        What is above half of its sample rate is folded below. None for a faster controller: nobody has seen what is
        above half of the rate at which the noise was seen.
        """
        if sample_time < _FASTER * self.sample_time:
            return None
        turned = np.mod(np.asarray(self.frequency) * sample_time, 2.0 * math.pi)
        return np.asarray(np.maximum(np.minimum(turned, 2.0 * math.pi - turned), 1e-6))


def noise_spectrum(rest: Floats, sample_time: float) -> NoiseSpectrum | None:
    """The spectrum of what a measurement does at rest; None where it may be white.

    Parameters
    ----------
    rest : ndarray, shape (n,)
    sample_time : float
        [s]

    References
    ----------
    Welch, IEEE Transactions on Audio and Electroacoustics 15 (1967) 70-73.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> noise_spectrum(rng.standard_normal(500), 0.1) is None
    True
    >>> hum = np.sin(2.0 * np.arange(500)) + 0.1 * rng.standard_normal(500)
    >>> seen = noise_spectrum(hum, 0.1)
    >>> round(seen.frequency[int(np.argmax(seen.share))], 1)
    20.0
    """
    straight = detrend(rest)
    if not np.any(straight) or whiteness(straight).p_value >= COLOURED:
        return None
    frequency, power = welch(straight, 2.0 * math.pi / sample_time, nperseg=min(rest.size, LONGEST))
    share = power[1:] / power[1:].sum()
    if share[:_WANDERS].sum() > 0.5:
        return None
    return NoiseSpectrum(tuple(frequency[1:].tolist()), tuple(share.tolist()), sample_time)
