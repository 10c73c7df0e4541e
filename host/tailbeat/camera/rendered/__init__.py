"""A camera over the simulated tank: what it would see, drawn from the simulator's truth."""
