"""The tuner node: tunes on request, learns from the running loop, hands over."""
