"""What people look at after a run: segments, tables, figures, pages."""
