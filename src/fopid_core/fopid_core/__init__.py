"""Fractional-order PID control: processes, loops, tuning, and the controller that runs."""
