"""What runs at every tick."""
