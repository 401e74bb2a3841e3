"""How to choose the controller's five numbers."""
