"""What the loop over ROS 2 costs, each figure beside a baseline."""
