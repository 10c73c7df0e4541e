"""Puts a film and a trial together: when in the film did the swim begin, and is it that trial?

Two ways. The LED's code (firmware/blink/blink.h) in the film: exact to some milliseconds, and it
names the trial. The fish's wobble: the turn the IMU felt in each tenth of a second, which the trial's
file holds, against the heading the camera saw.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from tailbeat.camera.track import Track
from tailbeat.errors import InputError
from tailbeat.trial_log import Trial


@dataclass(frozen=True)
class Sync:
    """``start_s``: the track's time at which frame 0 of the swim began; ``sigma_s`` of it.
    ``trial``: as read from the LED, modulo 256; None with ``yaw``. ``score``: 0..1, how much of what
    was seen is explained."""

    start_s: float
    sigma_s: float
    how: Literal["led", "yaw", "given"]
    trial: int | None
    score: float


class WrongPair(InputError):
    """The film does not show this trial."""


def sync_by_led(track: Track, trial: Trial | None = None) -> Sync:
    """By the LED. Without ``trial`` its number is read from the film. Raises WrongPair when the film
    shows another trial's number, InputError when no LED blinks in it or the track has no glow."""
    raise NotImplementedError


def sync_by_yaw(track: Track, trial: Trial) -> Sync:
    """By the wobble. Raises WrongPair when heading and turns do not belong together, or fit at
    another whole beat as well; InputError when the trial's file holds no turns."""
    raise NotImplementedError


def sync(track: Track, trial: Trial) -> Sync:
    """By the LED if there is one, otherwise by the wobble; when both are there they must agree
    within 5 sigma (WrongPair). Raises InputError when there is neither."""
    raise NotImplementedError
