"""Chapter 7 of the thesis."""
