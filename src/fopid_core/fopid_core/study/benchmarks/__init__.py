"""How fast the core is, each figure beside a baseline."""
