"""The command ``fopid``."""
