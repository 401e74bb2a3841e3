"""Which method, which structure: every one of them on one process, under one set of bounds, by the same measures."""
