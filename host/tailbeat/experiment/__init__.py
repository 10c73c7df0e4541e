"""Experiments: one folder holds everything about a series of trials."""
