"""Checks before a trial."""
