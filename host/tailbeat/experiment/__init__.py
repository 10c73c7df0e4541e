"""Experiments: one folder holds everything about a series of trials."""

from tailbeat.experiment.export import export
from tailbeat.experiment.folder import Experiment, list_experiments

__all__ = ["Experiment", "export", "list_experiments"]
