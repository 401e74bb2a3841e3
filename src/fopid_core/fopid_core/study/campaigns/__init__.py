"""Thousands of runs from one file."""
