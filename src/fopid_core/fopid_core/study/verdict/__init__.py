"""What fractional orders gain: every structure at equal bounds on many processes, and the page that says it."""
