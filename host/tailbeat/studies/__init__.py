"""Monte Carlo studies and the examples of the thesis."""
