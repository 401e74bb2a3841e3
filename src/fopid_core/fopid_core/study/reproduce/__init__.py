"""The paper computed again: its tables, figures and conclusions beside the printed ones, and where it errs."""
