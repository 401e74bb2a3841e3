"""Experiments: nodes started, phases run, signals recorded, a report written."""
