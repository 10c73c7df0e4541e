"""Finding the marker in a picture."""
