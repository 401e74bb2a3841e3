"""From a transfer function to the five numbers."""

import fopid_core as fopid

plant = fopid.read_process("1/(0.8s^2.2 + 0.5s^0.9 + 1) * exp(-0.1s)")
design = fopid.tune(plant, index="iae", ms_max=1.6)
print(design.message)
print("C(s) =", design.controller)
print(f"max |S| = {fopid.margins(plant, design).ms:.4f}")
