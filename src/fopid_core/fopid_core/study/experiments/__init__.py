"""Experiment files, and running them without ROS."""
