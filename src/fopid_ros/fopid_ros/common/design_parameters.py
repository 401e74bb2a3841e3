"""The controller's parameters that a design is made of: set together, kept together and taken back together."""

from __future__ import annotations

GAINS = ("kp", "ki", "kd", "lam", "mu")
FILTER = ("measurement_filter_order", "measurement_filter_time")
WEIGHTS = ("setpoint_weight", "derivative_setpoint_weight")
PACE = ("control_rate_max", "setpoint_rate_max")
"""Of a design that is only good behind a control or a setpoint that moves no faster."""
DEADBAND = "deadband"
LOOP = (*GAINS, *FILTER)
"""What is in the loop: what is known of one is not known of another."""
TWO_DEGREES = (*FILTER, *WEIGHTS)
"""What makes the five numbers a controller of two degrees of freedom."""
DESIGN = (*LOOP, *WEIGHTS, *PACE, DEADBAND)
PROVENANCE = {"gains.status": "set", "gains.origin": "", "gains.certificate": ""}
"""Parameters that say where the gains come from, and what they are when whoever sets gains does not say it."""
LONGEST_CERTIFICATE = 20_000
"""Characters that are kept; a longer proof is not handed over, the gains are."""
