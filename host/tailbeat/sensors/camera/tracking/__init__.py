"""The marker followed from picture to picture."""
