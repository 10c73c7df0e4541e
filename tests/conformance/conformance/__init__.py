"""Runs the conformance suite on a board through its console and judges the answers."""
