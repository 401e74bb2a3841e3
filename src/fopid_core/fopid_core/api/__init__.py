"""What people call from Python: text, numbers or objects in, results that show themselves out."""
