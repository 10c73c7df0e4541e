"""Experiments: one folder holds everything about a series of trials."""

from tailbeat.experiment.current import begin, current, require_same, use
from tailbeat.experiment.export import export
from tailbeat.experiment.folder import Experiment, list_experiments
from tailbeat.experiment.journal import Journal

__all__ = [
    "Experiment",
    "Journal",
    "begin",
    "current",
    "export",
    "list_experiments",
    "require_same",
    "use",
]
