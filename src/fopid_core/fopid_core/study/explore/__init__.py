"""The page without ROS: a process, sliders, and what would happen."""
