"""What the two pages share, the live one of a ROS loop and the one without ROS: access, server, and all components."""
