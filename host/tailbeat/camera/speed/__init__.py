"""Speed from positions."""
