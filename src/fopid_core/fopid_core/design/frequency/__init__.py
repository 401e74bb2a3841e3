"""Frequency-domain tuning, eqs. (1) to (5) of the paper: margins, flat phase, bounds on |T| and |S|."""
