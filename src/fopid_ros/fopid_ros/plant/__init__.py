"""The plant simulator node."""
