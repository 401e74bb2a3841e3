"""ROS 2 nodes of the fractional-order PID loop; the mathematics is in fopid_core."""
