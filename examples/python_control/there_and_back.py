"""Tuned here, looked at with python-control."""

import control
import numpy as np

import fopid_core as fopid

plant = control.tf([2], [1, 3, 3, 1])
design = fopid.tune(plant, phase_margin_deg=60, crossover=0.5)
loop = control.feedback(control.series(fopid.to_transfer_function(design.controller), plant), 1)
time = np.linspace(0.0, 20.0, 201)
_, approximated = control.forced_response(control.ss(loop), time, np.ones_like(time))
exact = fopid.step_response(plant, design, 20.0, points=201).output
print(f"largest distance from the exact response: {np.abs(approximated - exact).max():.3f}")
