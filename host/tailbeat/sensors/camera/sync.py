"""Puts a film and a trial together: when in the film did the trial begin, and is it that trial?

Two ways. The LED's code (led.py): exact to some milliseconds, and it names the trial. The yaw
oscillation: the turn the IMU measured in each tenth of a second, which the trial's file holds,
against the heading the camera saw. Camera headings are the IMU's, shifted in time and scaled, plus
whatever drifts (gyroscope, currents: a broken line with a knot every two beats), plus noise. Before
and after the trial the tail is still, so the onset counts as well.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.core.extras import lazy
from tailbeat.core.native import lib
from tailbeat.core.trial_file import SLOT_S, Trial
from tailbeat.sensors.camera.led import NUMBERS, read_led
from tailbeat.sensors.camera.tracking.track import Track

interpolate = lazy("scipy.interpolate")
ndimage = lazy("scipy.ndimage")

BEATS_MIN = 5
# On top of the wire. A VN-100 filters nothing that is late: its output is the mean over just the
# time since its last one (register 85), from 800 Hz samples. The simulated one is a servo frame
# late (LAG_US in sim/sensor/vn100_sense.c: its fish is known up to one frame ago). What a real one
# and its mounting add has not been measured. So anything from nothing to a servo frame, evenly: its
# middle, and its standard deviation; a simulated swim is found 10 ms too early.
_LATE_S = 0.010
LATE_SIGMA_S = 0.006
_BITS_PER_BYTE = 10
_USUAL_BAUD = 115200.0


class YawOscillation:
    """The IMU's heading over time since the trial's begin: the sum of its turns at the ends of the
    slots, and a cubic spline through them (ten points per beat). Before the trial, and after it if
    the turns reach to its end, it stands still. The IMU tells it late: by its frame's way over the
    wire and 10 +- LATE_SIGMA_S more (half a servo frame: nothing in the data sheet, a whole one in
    the simulator)."""

    def __init__(self, trial: Trial) -> None:
        """Raises InputError when the file holds no turns or the trial was too short."""
        turn = trial.slots.table()["turn_rad"]
        known = np.isfinite(turn)
        index = trial.slots.index[known].astype(int)
        swim_s = trial.executed_beats * trial.beat_s
        if trial.executed_beats < BEATS_MIN:
            raise too_short(trial)
        if len(index) * SLOT_S < BEATS_MIN * trial.beat_s:
            raise InputError(
                f"the file of trial {trial.number} does not say how the fish turned",
                "Without an IMU, or with an older firmware, film the LED or say --start.",
            )
        self.beat_s = trial.beat_s
        self.end_s = (int(index.max()) + 1) * SLOT_S
        slots = np.full(int(index.max()) + 1, np.nan)
        slots[index] = turn[known]
        self._known = np.isfinite(slots)
        self._still_after = self.end_s > swim_s - 1.5 * SLOT_S
        heading = np.concatenate([[0.0], np.cumsum(np.nan_to_num(slots))])
        self._spline = interpolate.CubicSpline(np.arange(len(heading)) * SLOT_S, heading)
        baud = trial.params.get("IMU_BAUD", 0.0)
        frame_bits = _BITS_PER_BYTE * int(lib.NATIVE_IMU_FRAME_BYTES)
        self._late_s = _LATE_S + frame_bits / (baud if baud > 0 else _USUAL_BAUD)

    def heading_rad(self, t_s: F64) -> F64:
        """At times since the begin; unknown turns count as none."""
        return np.asarray(self._spline(np.clip(t_s + self._late_s, 0, self.end_s)))

    def known(self, t_s: F64) -> NDArray[np.bool_]:
        """Whether the fish's turns are known then."""
        slot = np.clip((t_s / SLOT_S).astype(int), 0, len(self._known) - 1)
        after = (t_s >= self.end_s) & self._still_after
        return np.asarray((t_s < 0) | after | ((t_s < self.end_s) & self._known[slot]))


def too_short(trial: Trial) -> InputError:
    """That of a trial that was aborted before its yaw or LED tell anything."""
    beats = trial.executed_beats
    return InputError(
        f"trial {trial.number} has only {beats} executed beat{'s' * (beats != 1)}: "
        "too short to be put in time with a film",
        "Say when the trial begins: --start.",
    )


_COARSE_STEP_S = 0.05
_FINE_STEP_S = 0.005
_FINE_REACH_S = 0.1
_OTHER_BEAT = 0.5  # beats: where the neighbours begin
_KNOT_BEATS = 2.0
_STILL_BEFORE_S, _STILL_AFTER_S = 1.0, 0.3
_OVERLAP_MIN_BEATS = 5.0
_LAG_S = 0.5  # residuals further apart are taken to be independent
_HARMONICS = 3
# From beat to beat: marker askew, IMU's scale. Clean simulated films need none of it (uneven is
# 0.3 to 1.3 with it, median 0.7 at 25/s, 0.5 at 60/s); of a real marker, nobody measured it.
_SCALE_SIGMA = 0.02
_POWER_MIN_RAD2 = 1e-18  # nothing divides by less


@dataclass(frozen=True)
class YawFit:
    """``begin_s``: the track's time of the trial's begin. ``scale``: camera's yaw over IMU's.
    ``noise_rad``: the camera's, per picture. ``seen_rad``: RMS of the camera's, less noise.
    ``explained``: part of that, 0..1. ``excess``: what is left beyond noise over the oscillation,
    as variances. ``uneven``: mean chi^2 of the scale's changes over ``beats`` beats.
    ``ahead``: log likelihood ratio to the best begin half a beat or more away."""

    begin_s: float
    sigma_s: float
    scale: float
    noise_rad: float
    seen_rad: float
    explained: float
    excess: float
    uneven: float
    beats: int
    ahead: float


class Headings:
    """The camera's headings, shape (pictures,), without what drifts."""

    def __init__(self, t_s: F64, heading_rad: F64, beat_s: float) -> None:
        self.t_s, self.beat_s = t_s, beat_s
        knots = np.arange(t_s[0], t_s[-1] + _KNOT_BEATS * beat_s, _KNOT_BEATS * beat_s)
        hats = np.array([np.interp(t_s, knots, row) for row in np.eye(len(knots))]).T
        self._drift, _ = np.linalg.qr(hats[:, hats.any(axis=0)])
        self.rest = self.without_drift(heading_rad)

    def without_drift(self, series: F64) -> F64:
        """Less the broken line that fits it best."""
        return np.asarray(series - self._drift @ (self._drift.T @ series))


def scan(headings: Headings, yaw: YawOscillation) -> tuple[F64, F64]:
    """Begins, and the power of the headings that each explains (rad^2, summed over pictures)."""
    overlap_s = _OVERLAP_MIN_BEATS * yaw.beat_s
    first, last = headings.t_s[0] - yaw.end_s + overlap_s, headings.t_s[-1] - overlap_s
    begins = np.arange(first, last, _COARSE_STEP_S)
    return begins, np.array([explained_power(headings, yaw, begin) for begin in begins])


def explained_power(headings: Headings, yaw: YawOscillation, begin_s: float) -> float:
    """Of the oscillation that begins then, at its best size; 0 when that would be negative."""
    shape = _shape(headings, yaw, begin_s)
    power = float(shape @ shape)
    along = float(shape @ headings.rest)
    return along * abs(along) / power if power > 0 else 0.0


def _shape(headings: Headings, yaw: YawOscillation, begin_s: float) -> F64:
    return headings.without_drift(yaw.heading_rad(headings.t_s - begin_s))


def refine(headings: Headings, yaw: YawOscillation, begin_s: float) -> float:
    """The best begin near that one: the top of a parabola."""
    for reach_s, step_s in ((_FINE_REACH_S, 0.02), (0.03, _FINE_STEP_S)):
        begins = begin_s + np.arange(-reach_s, reach_s + step_s / 2, step_s)
        power = np.array([explained_power(headings, yaw, begin) for begin in begins])
        top = int(np.clip(np.argmax(power), 1, len(begins) - 2))
        left, middle, right = power[top - 1 : top + 2]
        bend = left - 2 * middle + right
        shift = 0.5 * (left - right) / bend if bend < 0 else 0.0
        begin_s = float(begins[top] + np.clip(shift, -1, 1) * step_s)
    return begin_s


def look(headings: Headings, yaw: YawOscillation, begins: F64, power: F64, top: float) -> YawFit:
    """How well the begin ``top`` fits; ``begins`` and ``power`` as ``scan`` gave them."""
    since_s = headings.t_s - top
    near = (since_s > -_STILL_BEFORE_S) & (since_s < yaw.end_s + _STILL_AFTER_S)
    near &= yaw.known(since_s)
    shape = _shape(headings, yaw, top)[near]
    rest = headings.rest[near]
    scale = float(shape @ rest / (shape @ shape))
    left = rest - scale * shape
    noise = _noise_rad(headings.rest[near], since_s[near], yaw)
    slope = (_shape(headings, yaw, top + 1e-3) - _shape(headings, yaw, top - 1e-3))[near]
    slope *= scale / 2e-3
    error_s = _sigma_s(slope, left, since_s[near])
    oscillation_rad = float(np.sqrt(np.mean(shape**2)))
    over = max(0.0, float(np.mean(left**2)) - noise**2)
    whole = max(float(np.mean(rest**2)) - noise**2, 1e-12)
    spread = max(float(np.mean(left**2)), _POWER_MIN_RAD2) * _correlation(left, since_s[near])
    uneven, beats = _uneven(shape * scale, left, since_s[near], noise, yaw.beat_s)
    others = np.where(np.abs(begins - top) > _OTHER_BEAT * yaw.beat_s, power, 0.0)
    rival = refine(headings, yaw, float(begins[np.argmax(others)]))
    return YawFit(
        begin_s=top,
        sigma_s=float(np.hypot(error_s, LATE_SIGMA_S)),
        scale=scale,
        noise_rad=noise,
        seen_rad=float(np.sqrt(whole)),
        explained=float(np.clip(1 - over / whole, 0, 1)),
        excess=over / max((scale * oscillation_rad) ** 2, 1e-12),
        uneven=uneven,
        beats=beats,
        ahead=(explained_power(headings, yaw, top) - explained_power(headings, yaw, rival))
        / (2 * spread),
    )


def _noise_rad(rest: F64, since_s: F64, yaw: YawOscillation) -> float:
    """Of one heading: what is left when every beat gets the harmonics that fit it best."""
    beat = np.floor(since_s / yaw.beat_s).astype(int)
    squares, free = 0.0, 0
    for k in np.unique(beat):
        mine = beat == k
        phase = 2 * np.pi * since_s[mine] / yaw.beat_s
        waves = [f(m * phase) for m in range(1, _HARMONICS + 1) for f in (np.sin, np.cos)]
        basis = np.array([np.ones_like(phase), phase, *waves]).T
        if len(basis) < basis.shape[1] + 3:
            continue
        _, residue, rank, _ = np.linalg.lstsq(basis, rest[mine], rcond=None)
        if len(residue):
            squares += float(residue[0])
            free += len(basis) - int(rank)
    return float(np.sqrt(squares / free)) if free else float(np.std(rest))


def _lagged(series: F64, t_s: F64) -> list[float]:
    """Its sums of products with itself up to _LAG_S later, from the first lag on."""
    lags = max(1, round(_LAG_S / float(np.median(np.diff(t_s)))))
    some = range(1, min(lags, len(series) - 1) + 1)
    return [float(series[:-lag] @ series[lag:]) for lag in some]


def _correlation(left: F64, t_s: F64) -> float:
    """How many residuals count as one, >= 1: the sum of their correlations up to _LAG_S."""
    power = float(left @ left)
    return max(1.0, 1.0 + 2.0 * sum(_lagged(left, t_s)) / power) if power > 0 else 1.0


def _sigma_s(slope: F64, left: F64, t_s: F64) -> float:
    """Of the begin, by least squares with residuals that go together for _LAG_S (Newey-West)."""
    lags = max(1, round(_LAG_S / float(np.median(np.diff(t_s)))))
    score = slope * left
    total = float(score @ score)
    for lag, product in enumerate(_lagged(score, t_s), start=1):
        total += 2 * (1 - lag / (lags + 1)) * product
    plain = float(np.mean(left**2)) * float(slope @ slope)
    return float(np.sqrt(max(total, plain)) / (slope @ slope))


def _uneven(shape: F64, left: F64, since_s: F64, noise: float, beat_s: float) -> tuple[float, int]:
    """Mean over the beats of (what of the residual looks like more or less oscillation)^2, in its
    own sigmas, and the beats that have an oscillation to speak of."""
    beat = np.floor(since_s / beat_s).astype(int)
    values = []
    for k in np.unique(beat):
        mine = shape[beat == k]
        power = float(mine @ mine)
        if power < 4 * noise**2:
            continue
        part = float(mine @ left[beat == k]) / power
        values.append(part**2 / (noise**2 / power + _SCALE_SIGMA**2))
    return (float(np.mean(values)) if values else 0.0), len(values)


SCALE_MIN, SCALE_MAX = 0.85, 1.2  # both are angles of the same fish
# Of right pairs (100 simulated swims of a learning fish each at 25 and 60 pictures/s, 10 % lost):
# clean, and with glare (another 0.02 rad of noise, 5 % of the headings 0.3 rad off; 25/s is worst).
#   excess                         clean <= 0.0024   glare <= 0.025   (95 %: 0.011)
#   ahead                          clean >= 34       glare >= 3       (median 31: 20 % are refused)
#   (uneven - 1) * sqrt(beats)     clean <= 1.9      glare <= 7.6     (95 %: 1.6)
#   seen / noise                   clean >= 3.5      glare >= 1.5
# So each limit is a factor of three or more from clean films. Wrong pairs show in uneven: with 3
# sigmas instead of 6, 43 instead of 80 of 800 would be taken, but right ones come near to 3.
EXCESS_MAX = 0.03
AHEAD_MIN = 10.0
_UNEVEN_SIGMAS = 6.0  # over sqrt(beats); a mean of chi^2 scatters by sqrt(2) of that
_OFF_MIN_RAD, _OFF_SIGMAS = 0.1, 6.0
_STILL_RAD = 1e-6  # headings that do not even scatter: frozen pictures, a fish held
_SEEN_MIN = 0.45  # oscillation over noise
AMBIGUOUS = "it fits at another beat as well"


class Misfit(Exception):
    """Film and file are not of one trial; the text says why."""


def read_yaw(track: Track, trial: Trial) -> YawFit:
    """The best begin. Raises InputError when the file holds no turns or the film no oscillation,
    Misfit when the two do not belong together or it cannot be said which beat is the first."""
    yaw = YawOscillation(trial)
    seen = track.seen() & np.isfinite(track.heading_rad)
    seen[seen] = _believed(track.heading_rad[seen])
    if np.count_nonzero(seen) < 2:
        raise _no_oscillation(track)
    headings = Headings(track.t_s[seen], track.heading_rad[seen], trial.beat_s)
    begins, power = scan(headings, yaw)
    if float(np.sqrt(np.mean(headings.rest**2))) < _STILL_RAD or len(begins) == 0:
        raise _no_oscillation(track)
    top = refine(headings, yaw, float(begins[np.argmax(power)]))
    found = look(headings, yaw, begins, power, top)
    if not found.seen_rad >= _SEEN_MIN * found.noise_rad:
        raise _no_oscillation(track)
    if reason := _misfit(found):
        raise Misfit(reason)
    return found


def _believed(heading_rad: F64) -> NDArray[np.bool_]:
    """Not those far from the median of their five neighbours: a marker seen askew."""
    off = np.abs(heading_rad - ndimage.median_filter(heading_rad, 5, mode="nearest"))
    return np.asarray(off <= max(_OFF_MIN_RAD, _OFF_SIGMAS * 1.4826 * float(np.median(off))))


def _misfit(found: YawFit) -> str:
    """Why the two do not belong together; "" = they do."""
    if found.excess > EXCESS_MAX:
        return f"only {found.explained:.0%} of the yaw oscillation in the film is in the file"
    if not SCALE_MIN <= found.scale <= SCALE_MAX:
        return f"the fish in the film turns {found.scale:.2f} times as far as in the file"
    if found.uneven > 1 + _UNEVEN_SIGMAS / np.sqrt(max(found.beats, 1)):
        return "the beats of the film are not as large as those of the file"
    if found.ahead < AHEAD_MIN:
        return AMBIGUOUS
    return ""


def _no_oscillation(track: Track) -> InputError:
    return InputError(
        f"{track.name}: the fish's heading shows no yaw oscillation to find the trial by",
        "Film the LED, or say --start.",
    )


_AGREE_SIGMAS = 5.0


@dataclass(frozen=True)
class Sync:
    """``start_s``: the track's time at which frame 0 of the trial began; ``sigma_s`` of it.
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
    patch."""
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
    """By the yaw. Raises WrongPair when heading and turns do not belong together, or fit at
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
    """By the LED if there is one, otherwise by the yaw; when both are there they must agree
    within 5 sigma (WrongPair). Raises InputError when there is neither, or the trial was too short
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
                f"{no_led.message}, and {no_yaw.message}", "Say when the trial begins: --start."
            ) from no_yaw
    _agree(led, track, trial)
    return led


def _agree(led: Sync, track: Track, trial: Trial) -> None:
    """A number is read modulo 256 and other fish have trials, too: the yaw may know better."""
    try:
        found = read_yaw(track, trial)
    except InputError:
        return
    except Misfit as why:
        if why.args[0] == AMBIGUOUS:
            return
        raise WrongPair(
            f"the LED shows trial {trial.number}, but {track.name} is of another trial: {why}",
            "Give the film's own trial file.",
        ) from why
    apart_s = abs(found.begin_s - led.start_s)
    if apart_s > _AGREE_SIGMAS * math.hypot(led.sigma_s, found.sigma_s):
        raise WrongPair(
            f"the LED says the trial began at {led.start_s:.2f} s, "
            f"the fish's yaw oscillation at {found.begin_s:.2f} s",
            "Give the film's own trial file.",
        )
