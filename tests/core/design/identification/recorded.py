"""Records of plants, made by the runtime's plant: exact for a held control, and no code shared with the fit."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from fopid_core.design.identification.record import Record
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import read_process
from fopid_core.runtime.controller import ControllerSettings, FopidController
from fopid_core.runtime.plant import Plant, PlantSettings
from fopid_core.runtime.simulation import Signal, simulate


def plant(process: str, sample_time: float, noise: float = 0.0, seed: int = 0, output: float = 0.0) -> Plant:
    """A plant with exact delay."""
    settings = PlantSettings(
        read_process(process), sample_time, "exact", noise_std=noise, seed=seed, initial_output=output
    )
    return Plant(settings)


def open_loop(process: str, control: ArrayLike, sample_time: float, noise: float = 0.0, seed: int = 0) -> Record:
    """What a plant at rest answers to a control."""
    values = np.asarray(control, dtype=np.float64)
    running = plant(process, sample_time, noise, seed)
    measurement = np.empty_like(values)
    for k, value in enumerate(values):
        measurement[k] = running.measurement
        running.step(value)
    return Record(sample_time * np.arange(values.size), values, measurement)


def step_record(process: str, duration: float, sample_time: float, noise: float = 0.0, seed: int = 0) -> Record:
    """A step from rest after a fifth of the duration [s]."""
    samples = round(duration / sample_time)
    return open_loop(process, np.arange(samples) >= samples // 5, sample_time, noise, seed)


def closed_loop(
    process: str,
    setpoint: Signal,
    samples: int,
    sample_time: float,
    gains: Fopid | None = None,
    noise: float = 0.0,
    seed: int = 0,
    disturbance: Callable[[int], float] = lambda _: 0.0,
    output: float = 0.0,
) -> Record:
    """A plant under a controller, from rest at ``output``."""
    controller = FopidController(ControllerSettings(gains or Fopid(kp=1.0, ki=0.5), sample_time=sample_time))
    trace = simulate(controller, plant(process, sample_time, noise, seed, output), samples, setpoint, disturbance)
    return Record(trace.time, trace.control, trace.measurement, trace.setpoint)


def square_wave(period: int, low: float = 0.0) -> Signal:
    """Between ``low`` and ``low + 1``, in samples."""
    return lambda k: low + float(k // (period // 2) % 2)


BALL_RUNAWAY, BALL_GAIN = 14.0, -3132.0
"""Of the ball below at its rest: x'' = 14.0^2 x - 3132 i, gap in mm, current in A."""


def levitated_ball(samples: int, seed: int = 0) -> Record:
    """A steel ball 50 mm below a magnet, held by a PID without filter at 2 ms, with bits added to the current.

    The pull goes with the square of the current over the gap: the derivative's noise in the current makes a load.
    """
    rng, h = np.random.default_rng(seed), 0.002
    rest = math.sqrt(39.24)  # 0.1 kg, 0.01 H, 50 mm
    bits = 0.05 * np.repeat(rng.choice([-1.0, 1.0], samples // 100 + 1), 100)[:samples]
    gap, speed, integral, error_before = 0.05, 0.0, 0.0, 0.0
    control, measured = np.zeros(samples), np.zeros(samples)
    for k in range(samples):
        measured[k] = round((1000.0 * gap + 0.02 * rng.standard_normal()) / 0.01) * 0.01
        error = 50.0 - measured[k]
        integral += h * error
        control[k] = rest - 0.6 * error - 2.0 * integral - 0.02 * (error - error_before) / h + bits[k]
        error_before = error
        for _ in range(4):  # steps of the leapfrog method
            gap += 0.125 * h * speed
            speed += 0.25 * h * (9.81 - 0.0025 * (control[k] / (0.05 + gap)) ** 2)
            gap += 0.125 * h * speed
    return Record(h * np.arange(samples), control, measured, excitation=bits)
