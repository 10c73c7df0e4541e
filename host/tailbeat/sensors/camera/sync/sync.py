"""Puts a film and a trial together: when in the film did the swim begin, and is it that trial?

Two ways. The LED's code (firmware/blink/blink.h) in the film: exact to some milliseconds, and it
names the trial. The fish's wobble: the turn the IMU felt in each tenth of a second, which the
trial's file holds, against the heading the camera saw.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from tailbeat.core.errors import InputError
from tailbeat.core.trial_file import Trial
from tailbeat.sensors.camera.sync.led import read_led
from tailbeat.sensors.camera.sync.led_search import NUMBERS
from tailbeat.sensors.camera.sync.yaw import AMBIGUOUS, BEATS_MIN, Misfit, read_yaw, too_short
from tailbeat.sensors.camera.tracking.track import Track

_AGREE_SIGMAS = 5.0


@dataclass(frozen=True)
class Sync:
    """``start_s``: the track's time at which frame 0 of the swim began; ``sigma_s`` of it.
    ``trial``: as read from the LED, modulo 256; None with ``yaw``. ``score``: 0..1, how much of
    what was seen is explained."""

    start_s: float
    sigma_s: float
    how: Literal["led", "yaw", "given"]
    trial: int | None
    score: float


class WrongPair(InputError):
    """The film does not show this trial."""


def sync_by_led(track: Track, trial: Trial | None = None) -> Sync:
    """By the LED. Without ``trial`` its number is read from the film. Raises WrongPair when the
    film shows another trial's number, InputError when no LED blinks in it or the track has no
    glow."""
    if trial is None:
        reading = read_led(track)
    else:
        reading = read_led(track, trial.executed_beats * trial.beat_s, trial.beat_s)
    if trial is not None and reading.number != trial.number % NUMBERS:
        raise WrongPair(
            f"the film shows trial {reading.number} (or one {NUMBERS} away), "
            f"the file is trial {trial.number}",
            "Give the film's own trial file.",
        )
    return Sync(reading.begin_s, reading.sigma_s, "led", reading.number, reading.score)


def sync_by_yaw(track: Track, trial: Trial) -> Sync:
    """By the wobble. Raises WrongPair when heading and turns do not belong together, or fit at
    another whole beat as well; InputError when the trial's file holds no turns."""
    try:
        found = read_yaw(track, trial)
    except Misfit as why:
        raise WrongPair(
            f"{track.name} and trial {trial.number} do not go together: {why}",
            "Give the film's own trial file, or say --start.",
        ) from why
    return Sync(found.begin_s, found.sigma_s, "yaw", None, found.explained)


def sync(track: Track, trial: Trial) -> Sync:
    """By the LED if there is one, otherwise by the wobble; when both are there they must agree
    within 5 sigma (WrongPair). Raises InputError when there is neither, or the swim was too short
    for both."""
    try:
        led = sync_by_led(track, trial)
    except WrongPair:
        raise
    except InputError as no_led:
        if trial.executed_beats < BEATS_MIN:
            raise too_short(trial) from no_led
        try:
            return sync_by_yaw(track, trial)
        except WrongPair:
            raise
        except InputError as no_yaw:
            raise InputError(
                f"{no_led.message}, and {no_yaw.message}", "Say when the swim begins: --start."
            ) from no_yaw
    _agree(led, track, trial)
    return led


def _agree(led: Sync, track: Track, trial: Trial) -> None:
    """A number is read modulo 256 and other fish have trials, too: the wobble may know better."""
    try:
        found = read_yaw(track, trial)
    except InputError:
        return
    except Misfit as why:
        if why.args[0] == AMBIGUOUS:
            return
        raise WrongPair(
            f"the LED shows trial {trial.number}, but {track.name} is of another swim: {why}",
            "Give the film's own trial file.",
        ) from why
    apart_s = abs(found.begin_s - led.start_s)
    if apart_s > _AGREE_SIGMAS * math.hypot(led.sigma_s, found.sigma_s):
        raise WrongPair(
            f"the LED says the swim began at {led.start_s:.2f} s, "
            f"the fish's wobble at {found.begin_s:.2f} s",
            "Give the film's own trial file.",
        )
