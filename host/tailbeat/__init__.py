"""tailbeat: a robotic fish learns to swim along a speed profile.

    from tailbeat import Fish, reference
    with Fish.connect("sim") as fish:
        fish.upload_reference(reference.thesis().record())
        fish.arm()
        outcome = fish.run_trial()
        report = fish.learn()

Names are loaded on first use, so that importing the package is quick.
"""

from __future__ import annotations

TYPE_CHECKING = False  # as typing has it, which takes 20 ms in which Ctrl-C cannot be caught

if TYPE_CHECKING:
    from typing import Any

    from tailbeat.errors import TailbeatError
    from tailbeat.experiment import Experiment
    from tailbeat.fish import Fish
    from tailbeat.laws import Law
    from tailbeat.reference import Reference
    from tailbeat.trial_log import Trial, read_trial

__all__ = ["Experiment", "Fish", "Law", "Reference", "TailbeatError", "Trial", "read_trial"]

_HOME = {
    "Experiment": "experiment",
    "Fish": "fish",
    "Law": "laws",
    "Reference": "reference",
    "TailbeatError": "errors",
    "Trial": "trial_log",
    "read_trial": "trial_log",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'tailbeat' has no attribute '{name}'")
    from importlib import import_module

    return getattr(import_module(f"tailbeat.{_HOME[name]}"), name)
