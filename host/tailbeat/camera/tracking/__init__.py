"""One fish, from picture to picture."""
