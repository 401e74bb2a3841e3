"""The pictures of the concept page, computed with the package itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import fopid_core as fopid

PLANT = "1/(s+1)^3"
ORDERS = (0.5, 0.75, 1.0, 1.25)


def write(folder: Path) -> None:
    """Draw what is not there yet."""
    folder.mkdir(exist_ok=True)
    drawings = {"bode": bode, "lam": lam, "mu": mu, "flat_phase": flat_phase, "orders": orders}
    for name, draw in drawings.items():
        path = folder / f"{name}.svg"
        if not path.exists() or path.stat().st_mtime < Path(__file__).stat().st_mtime:
            draw().savefig(path)


def _figure(rows: int, columns: int, height: float) -> tuple[Figure, np.ndarray]:
    figure = Figure(figsize=(8.0, height), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    for each in axes.flat:
        each.grid(True, alpha=0.3)
    return figure, axes


def bode() -> Figure:
    """Gain and phase of the integral for several orders: slope and angle are one number."""
    figure, axes = _figure(1, 2, 3.2)
    w = np.logspace(-2, 2, 200)
    for order in ORDERS:
        value = fopid.Fopid(0.0, 1.0, 0.0, lam=order)(1j * w)
        axes[0, 0].semilogx(w, 20 * np.log10(np.abs(value)), label=f"λ = {order:g}")
        axes[0, 1].semilogx(w, np.degrees(np.angle(value)))
    axes[0, 0].set(xlabel="ω [rad/s]", ylabel="gain of s^-λ [dB]")
    axes[0, 1].set(xlabel="ω [rad/s]", ylabel="phase of s^-λ [deg]", ylim=(-130, 10))
    axes[0, 0].legend()
    return figure


def lam() -> Figure:
    """Step responses for several orders of the integral."""
    return _steps([fopid.Fopid(0.8, 0.4, 0.5, lam=order) for order in ORDERS], [f"λ = {order:g}" for order in ORDERS])


def mu() -> Figure:
    """Step responses for several orders of the derivative."""
    orders = (0.4, 0.7, 1.0, 1.3)
    return _steps([fopid.Fopid(1.5, 0.5, 1.5, mu=order) for order in orders], [f"μ = {order:g}" for order in orders])


def _steps(controllers: list[fopid.Fopid], labels: list[str]) -> Figure:
    figure, axes = _figure(1, 2, 3.2)
    for controller, label in zip(controllers, labels, strict=True):
        for place, source in enumerate(("setpoint", "load")):
            response = fopid.step_response(PLANT, controller, 25.0, source=source, points=400)  # type: ignore[arg-type]
            axes[0, place].plot(response.time, response.output, label=label)
    axes[0, 0].set(xlabel="time [s]", ylabel="output", title="setpoint step")
    axes[0, 1].set(xlabel="time [s]", title="load step")
    axes[0, 0].legend()
    return figure


def flat_phase() -> Figure:
    """The same overshoot for every gain: what the flat phase of a frequency design buys."""
    figure, axes = _figure(1, 2, 3.2)
    designs = {"classical PID (amigo-pid)": fopid.tune(PLANT, rule="amigo-pid"),
               "flat phase at 0.3 rad/s": fopid.tune(PLANT, phase_margin_deg=65, crossover=0.3)}  # fmt: skip
    for place, (name, design) in enumerate(designs.items()):
        for gain in (0.7, 1.0, 1.4):
            response = fopid.step_response(gain * fopid.read_process(PLANT), design, 40.0, points=400)
            axes[0, place].plot(response.time, response.output, label=f"gain x {gain:g}")
        axes[0, place].set(xlabel="time [s]", title=name, ylim=(0.0, 1.5))
    axes[0, 0].legend()
    return figure


def orders() -> Figure:
    """The square of the two orders, with the classical controllers at its corners."""
    figure, axes = _figure(1, 1, 3.2)
    plane = axes[0, 0]
    plane.fill_between([0, 2], 0, 2, alpha=0.15)
    for place, name in (((0, 0), "P"), ((1, 0), "PI"), ((0, 1), "PD"), ((1, 1), "PID")):
        plane.plot(*place, "o", color="C0")
        plane.annotate(name, place, (6, 6), textcoords="offset points")
    plane.set(xlabel="λ", ylabel="μ", xlim=(-0.05, 2.05), ylim=(-0.05, 2.05), aspect="equal")
    return figure
