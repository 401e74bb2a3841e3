"""The best PID and the best FOPID for the same bounds, on three plants."""

import fopid_core as fopid

for text in ("1/(s+1)^3", "1/(s+1)*exp(-0.5s)", "9/((s+1)(s^2+2s+9))"):
    pid = fopid.tune(text, index="iae", ms_max=1.6, structure="pid")
    best = fopid.tune(text, index="iae", ms_max=1.6, structure="fopid")
    assert pid.success
    assert best.success
    gain = 1.0 - best.cost / pid.cost
    print(f"{text:24} PID {pid.cost:.3f}  FOPID {best.cost:.3f}  {gain:.0%} less, with {best.controller}")
    figure = fopid.step_response(text, pid, 15).plot(label="PID", title=text)
    fopid.step_response(text, best, 15).plot(figure, label="FOPID")
figure.savefig("pid_against_fopid.png")
