"""Time-domain tuning, eqs. (23) to (30) of the paper: an index of the step response under bounds."""
