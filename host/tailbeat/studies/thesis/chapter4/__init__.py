"""Chapter 4 of the thesis."""
