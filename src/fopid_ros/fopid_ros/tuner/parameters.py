"""Parameters of the tuner node: what a request leaves open."""

from __future__ import annotations

import math

from fopid_core.design.acceptance import DELAY_MARGIN_TICKS, MS_MAX
from fopid_core.design.specification import INPUTS, METHODS, STRUCTURES, VIA
from fopid_ros.common.parameters import Spec
from fopid_ros.tuner.learning import loop_tap

ADAPT = ("off", "propose", "apply")
"""What may be done when the process has drifted."""
_ZERO_CHOOSES = "; 0 leaves it to the method"

SPECS = (
    Spec("process", "", "P1 ... P4 or a transfer function in s as text; empty until known"),
    Spec("controller", "fopid_controller", "node name of the controller", read_only=True),
    Spec("dof", "", "the joint to tune, of a controller with dof_names; empty for a controller of one loop",
         at_configure=True),
    Spec("method", "frequency", "what ~/tune does when not told", choices=METHODS),
    Spec("phase_margin", 0.0, f"phase margin to reach [rad]{_ZERO_CHOOSES}", 0.0, math.pi),
    Spec("crossover", 0.0, f"gain crossover to reach [rad/s]{_ZERO_CHOOSES}", 0.0, 1e9),
    Spec("t_max_db", 0.0, "bound on |T| from t_max_frequency on [dB]", -1e3, 1e3),
    Spec("t_max_frequency", 0.0, "where that bound begins [rad/s]; 0 for no bound", 0.0, 1e9),
    Spec("s_max_db", 0.0, "bound on |S| up to s_max_frequency [dB]", -1e3, 1e3),
    Spec("s_max_frequency", 0.0, "where that bound ends [rad/s]; 0 for no bound", 0.0, 1e9),
    Spec("via", "none", "template the process is reduced to before tuning by frequency", choices=VIA),
    Spec("index", "itae", "what time-domain tuning makes small: iae ise itae itse istes istse sum"),
    Spec("horizon", 0.0, f"time the index is integrated over [s]{_ZERO_CHOOSES}", 0.0, 1e9),
    Spec("ms_max", 0.0, f"bound on max |S|{_ZERO_CHOOSES}", 0.0, 1e3),
    Spec("u_max", 0.0, f"bound on the control's peak after a unit setpoint step{_ZERO_CHOOSES}", 0.0, 1e9),
    Spec("input", "setpoint", "the step whose index time-domain tuning makes small", choices=INPUTS),
    Spec("structure", "", "structure of the controller; empty: the simplest that costs hardly more",
         choices=("", *STRUCTURES)),
    Spec("mt_max", 0.0, "bound on max |T|; 0 for none", 0.0, 1e3),
    Spec("noise_max", 0.0, f"bound on the gain from measurement noise to control{_ZERO_CHOOSES}", 0.0, 1e12),
    Spec("filter_order", 0, "order of the filter of the measurement that time-domain tuning chooses; 0 for none", 0, 2),
    Spec("setpoint_weights", "", "chosen with the gains, or one; empty: chosen where the load or a filter counts",
         choices=("", "chosen", "one")),
    Spec("rule", "", "name of the tuning rule"),
    Spec("timeout", 30.0, "give the best found after this long, marked unsuccessful [s]", 1e-3, 1e6),
    Spec("sample_time", 0.01, "tick of the controller that will run the gains [s]", 1e-6, 1e6),
    Spec("verify.ms_max", MS_MAX, "gains with a larger max |S| are not applied", 1.0, 1e6),
    Spec("verify.certify", False, "gains without a proof of stability and of verify.ms_max are not applied"),
    Spec("verify.region", "samples", "what of a learnt process is proved before gains are applied: its covariance's "
         "ellipsoid or the box about it; samples are tried, not proved", choices=("samples", "ellipsoid", "box")),
    Spec("verify.confidence", 0.95, "that the true parameters are in that region", 0.5, 0.999999),
    Spec("verify.box", "", "~/tune: ranges of the process's parameters, proved before gains are applied, as "
         "'K=0.8,1.2 L=0,0.3'"),
    Spec("verify.worst_ms_max", 2.5, "the same, on every process that a record leaves possible", 1.0, 1e6),
    Spec("verify.worst_phase_margin", math.radians(30.0), "least phase margin there [rad]", 0.0, math.pi),
    Spec("verify.ticks", DELAY_MARGIN_TICKS, "gains with a delay margin of fewer ticks are not applied", 0.0, 1e6),
    Spec("verify.noise_share", 0.01, "share of the control's range that noise may move it by under new gains [std]",
         1e-9, 1.0),
    Spec("autotune.excitation", "prbs", "how ~/autotune moves the loop", choices=("prbs", "relay", "step")),
    Spec("autotune.amplitude", 0.0, "how far it moves the control; 0 finds out", 0.0, 1e9),
    Spec("autotune.deviation_max", 0.0, "distance from setpoint that ends it; 0: from noise and limits", 0.0, 1e9),
    Spec("autotune.duration", 0.0, "length of the experiment [s]; 0: 18 integral times of the gains", 0.0, 1e9),
    Spec("autotune.until_known", True, "a prbs without duration ends once its record says enough for a design"),
    Spec("autotune.second_round", True, "a second round where no slow end was seen, or gains are much livelier"),
    Spec("adapt", "off", "learn on from normal operation and retune when the process has drifted", choices=ADAPT),
    Spec("adapt_window", 0.0, "signals that a drift is judged by [s]; 0: 18 integral times of the gains", 0.0, 1e6),
    *loop_tap.SPECS,
)  # fmt: skip
