"""The simulated board and its world, in this process or served over TCP."""
