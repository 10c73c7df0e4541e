"""Speed from tracked positions."""
