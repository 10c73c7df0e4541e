"""tailbeat: a robotic fish learns to track a speed profile.

::

    from tailbeat import Fish, reference, run_trial
    with Fish.connect("sim") as fish:
        fish.upload_reference(reference.thesis().record())
        fish.arm()
        outcome = run_trial(fish)
        report = fish.learn()

Names are loaded on first use, so that importing the package is quick.
"""

from __future__ import annotations

TYPE_CHECKING = False  # as typing has it, which takes 20 ms in which Ctrl-C cannot be caught

if TYPE_CHECKING:
    from typing import Any

    from tailbeat.board.fish import Fish
    from tailbeat.core import reference
    from tailbeat.core.errors import TailbeatError
    from tailbeat.core.law import Law
    from tailbeat.core.reference import Reference
    from tailbeat.core.trial_file import Trial, read_trial
    from tailbeat.experiment.folder import Experiment
    from tailbeat.session.trial import run_trial

__all__ = [
    "Experiment",
    "Fish",
    "Law",
    "Reference",
    "TailbeatError",
    "Trial",
    "read_trial",
    "reference",
    "run_trial",
]

_HOME = {
    "Experiment": "experiment.folder",
    "Fish": "board.fish",
    "Law": "core.law",
    "Reference": "core.reference",
    "TailbeatError": "core.errors",
    "Trial": "core.trial_file",
    "read_trial": "core.trial_file",
    "run_trial": "session.trial",
}


def __getattr__(name: str) -> Any:
    from importlib import import_module

    if name == "reference":
        return import_module("tailbeat.core.reference")
    if name not in _HOME:
        raise AttributeError(f"module 'tailbeat' has no attribute '{name}'")
    return getattr(import_module(f"tailbeat.{_HOME[name]}"), name)
