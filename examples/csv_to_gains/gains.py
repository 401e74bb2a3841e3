"""From a csv file to gains, in parallel and in standard form."""

import sys

import fopid_core as fopid

found = fopid.identify(sys.argv[1])
print(found.message)
model = found.best
assert found.success
assert model is not None
print("process:", model.process)

pid = fopid.tune(model.process, index="iae", ms_max=1.6, structure="pid", sample_time=1.0)
best = fopid.tune(model.process, index="iae", ms_max=1.6, structure="fopid", sample_time=1.0)
kp, ki, kd, _, _ = pid.controller.gains
print(f"PID   IAE {pid.cost:.1f}: K = {kp:.4g} %/degC, Ti = {kp / ki:.4g} s, Td = {kd / kp:.4g} s")
print(f"FOPID IAE {best.cost:.1f}: {best.controller}")
