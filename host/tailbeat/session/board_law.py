"""The P law that the board goes on by where it is alone: designed for the fish, its reference and
its amplitude limit, kept in the trial library and stored on the board.
"""

from __future__ import annotations

from tailbeat.board.fish import Fish
from tailbeat.board.snapshot import differences
from tailbeat.core.reference import Reference
from tailbeat.experiment.current import set_and_save
from tailbeat.experiment.library import library_of
from tailbeat.learning.design import design
from tailbeat.learning.identification import Identified
from tailbeat.learning.saturation import needed_rad, servo_rad

_GAIN = "ILC_GAIN"


def store_law(fish: Fish, reference: Reference, identified: Identified) -> str:
    """Designs the law, or takes the one that was designed before for the same model, reference and
    limit, and stores it on the board. Why there is none; empty = it is stored."""
    params, book = fish.params.values(), library_of(fish)
    most = min(needed_rad(identified, reference), servo_rad(params), params["AMP_MAX_RAD"])
    key = f"{identified.made} {reference.crc:08x} {most:.4f}"
    law = None if book is None else book.designed_law(key)
    if law is None:
        found = design(identified, reference, most, step_max_rad=params["DU_MAX_RAD"])
        if found.refused:
            return found.refused
        # the certificate is for kd = 0, a constant gain and the last trial alone
        law = found.law.params()
        if book is not None:
            book.set_designed_law(key, law)
    differing = {name: law[name] for name in differences(params, law)}
    if differing:
        set_and_save(fish, differing)
    return ""


def lower_gain(fish: Fish, gain: float) -> None:
    """Now, and whenever the law is stored again."""
    set_and_save(fish, {_GAIN: gain})
    if (book := library_of(fish)) is not None:
        book.change_designed_law({_GAIN: gain})
