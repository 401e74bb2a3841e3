"""Time-domain tuning, eqs. (23) to (30): the best index of the step response under bounds.

Every index of the error asks for more gain without end, so bounds belong to the specification: on max |S|, on the peak
of the control and on the gain from measurement noise to control. The ideal controller answers a setpoint step with an
infinite control as soon as it differentiates; bounded is the control of the controller as it runs, which takes the error
as linear between samples. Its first sample then is kp + ki h^lam / Gamma(2 + lam) + kd h^-mu / Gamma(2 - mu).

The default optimiser is sequential quadratic programming from the best of many designs that lie on the bounds already;
all of a step's gradient comes from one batch of responses. An unstable loop never wins: every candidate is decided by the
argument principle on the process itself.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.special import rgamma

from fopid_core.design.objectives import Objective
from fopid_core.design.search_response import ResponseGrid
from fopid_core.model.fopid import Fopid
from fopid_core.model.process import Process
from fopid_core.model.stability import stable_mask

Real = NDArray[np.float64]
