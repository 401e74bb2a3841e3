"""What a loop is: the process, the controller, and what they do together."""
