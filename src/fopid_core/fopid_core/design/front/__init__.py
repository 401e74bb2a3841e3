"""The whole trade-off: load performance, robustness and control effort of one structure on one process."""
