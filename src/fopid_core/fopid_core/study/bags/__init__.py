"""Recordings: reading, writing and mending rosbag2 bags."""
