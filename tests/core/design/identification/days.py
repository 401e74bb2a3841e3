"""Days of a plant under a PI controller while loads wander, and what gains are worth on that plant itself."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.signal import cont2discrete

from fopid_core.design.identification.record import Record
from fopid_core.model.fopid import Fopid
from fopid_core.model.two_degrees import MeasurementFilter
from fopid_core.runtime.controller import ControllerSettings, FopidController


@dataclass(frozen=True)
class Day:
    """Two lags and a delay, sampled exactly, the control held; a random walk as load, and what else may be amiss."""

    gain: float = 2.0
    lags: tuple[float, float] = (200.0, 40.0)
    delay: int = 3  # samples
    h: float = 10.0
    samples: int = 4000
    walk: float = 0.02  # of the load within a second, in units of the control
    noise: float = 0.05
    moves: tuple[float, ...] = (3.0, -2.0, 4.0)
    play: float = 0.0  # of the actuator, to each side
    sticks: float = 0.0  # within so much
    sine: float = 0.0  # of the load, over 40 of the longer lag
    hops: float = 0.0  # of the load, three in a day
    strength: float = 0.4  # of the controller
    rate: float = math.inf  # of the actuator, in a second

    def gains(self, times: float = 1.0) -> Fopid:
        """Of the PI controller, so many times as strong."""
        kp = times * self.strength * sum(self.lags) / (self.gain * (2.0 * self.delay * self.h + self.lags[1]))
        return Fopid(kp, kp / sum(self.lags))

    def record(self, seed: int, gains: Fopid | None = None) -> Record:
        """The same loads and noise for a seed, whatever the gains."""
        rng, (first, second) = np.random.default_rng(seed), self.lags
        a = np.array([[-1.0 / first, 0.0], [1.0 / second, -1.0 / second]])
        system = a, np.array([[self.gain / first], [0.0]]), np.array([[0.0, 1.0]]), np.zeros((1, 1))
        a, b, *_ = cont2discrete(system, self.h, "zoh")
        controller = FopidController(ControllerSettings(gains or self.gains(), self.h))
        setpoint = np.zeros(self.samples)
        for k, move in enumerate(self.moves):
            setpoint[round((k + 0.6) / len(self.moves) * self.samples) :] += move
        hops = np.cumsum(
            self.hops * rng.standard_normal(self.samples) * (rng.random(self.samples) < 3.0 / self.samples)
        )
        sine = self.sine * np.sin(2.0 * math.pi * self.h / (40.0 * max(self.lags)) * np.arange(self.samples))
        x, walked, stem, driven, arriving, rows = np.zeros(2), 0.0, 0.0, 0.0, [0.0] * self.delay, []
        for wanted, load in zip(setpoint.tolist(), (hops + sine).tolist(), strict=True):
            measured = float(x[1]) + self.noise * rng.standard_normal()
            control = controller.step(wanted, measured)
            rows.append((control, measured))
            walked += self.walk * math.sqrt(self.h) * rng.standard_normal()
            stem = min(max(stem, control - self.play), control + self.play) if self.play else stem
            stem = control if not self.play and abs(control - stem) > self.sticks else stem
            driven += min(max(stem - driven, -self.rate * self.h), self.rate * self.h)
            arriving.append(driven + load + walked)
            x = a @ x + b[:, 0] * arriving.pop(0)
        control, measured = np.array(rows).T
        return Record(self.h * np.arange(self.samples), control, measured, setpoint)

    def response(self, frequency: np.ndarray) -> np.ndarray:
        """Of the process, without its hold."""
        s = 1j * frequency
        first, second = self.lags
        return self.gain / ((first * s + 1.0) * (second * s + 1.0)) * np.exp(-self.delay * self.h * s)

    def peak(self, c: Fopid, slow: MeasurementFilter) -> float:
        """max |S| of the true process with these gains, the control held for a sample; infinite where unstable."""
        w = np.geomspace(1e-7, math.pi / self.h, 30_000)
        s = 1j * w
        held = np.exp(-0.5 * self.h * s) * np.sinc(0.5 * self.h * w / math.pi)
        loop = 1.0 + (c.kp + c.ki * s**-c.lam + c.kd * s**c.mu) * slow(s) * self.response(w) * held
        turned = np.unwrap(np.angle(loop))
        stable = abs(turned[-1] - turned[0] - 0.5 * math.pi * c.lam) < 1.0  # none of its zeros on the right
        return float(np.abs(1.0 / loop).max()) if stable else math.inf
