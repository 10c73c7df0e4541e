"""Chapter 8 of the thesis."""
