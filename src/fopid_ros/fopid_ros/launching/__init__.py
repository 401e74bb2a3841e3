"""What the launch files are made of: parameters of a loop, and actions that fail when a node fails."""
