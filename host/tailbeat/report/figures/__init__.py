"""Figures of experiments, for a page and for a paper: the same drawing code, two styles."""
