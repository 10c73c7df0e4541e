"""Whether something other than its tail moved the fish in a trial: a hand, the wall, a wave.

The trial is its own measure: a fish in four numbers is fitted to it without the beats that do not
fit (one with a shape would follow a push near the end), and what it misses must not jump from one
beat to the next. Nothing need be known of the fish. On the simulated tank, seeds 1 to 20, trials 1
to 10 from a first input near the dead zone, the largest jump of 200 trials was 2.6 mm/s; of 200
that were pushed by 50 mm/s at any beat, 22.9 to 39.6, all flagged. Of 78 trials of 13 other fish,
references and cameras none was flagged (noise 5 mm, every third picture lost: 15.9 mm/s, of 34
allowed). On the second plant, seeds 1 to 12: 0 of 72 clean trials, 60 of 60 pushed by beat 11. A
push whose trace is gone within the beat is not found: at kappa 30 / m and 90 mm/s one of 50 mm/s
leaves 8 mm/s.

What an identification is worth, for people: how well the model fits, and what to mistrust.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.core.trial_checks import spans
from tailbeat.core.trial_file import read_trial
from tailbeat.learning.fish_model import FishModel, TrialSpeeds, trial_speeds
from tailbeat.learning.fit import Prior, fit
from tailbeat.learning.identification import Identified, ThesisFish
from tailbeat.learning.identification_runs import STILL_M_S, identify_trials

_JUMP_M_S = 0.012  # what people do to a fish is more
_SCATTERS = 5.0  # of the jumps in this trial; 4.9 is the most that chance made of 200
_SIGMAS = 6.0  # of a beat's measurement
_BEATS_MIN = 6  # fewer follow any model
_FITS = 4
_PLAIN = Prior(
    FishModel(10.0, 0.2, 0.17, 0.3, wake_share=0.01, wake_s=1.0),
    bend_per_rad=0.02, linear_drag_m_s=1e-4, wake_share=0.002, wake_s=0.05,
)  # fmt: skip
_FITS_M_S, _FITS_MADS = 0.004, 4.0  # a beat farther off does not take part in the next fit
_FADED = 0.25  # of the jump: what is left of it does not count as its beats
_MAD = 1.4826  # standard deviations of normal noise


@dataclass(frozen=True)
class Disturbance:
    """``beats`` from where the speed left what the tail does until it is back there; ``by_m_s``:
    the jump, forward positive."""

    beats: range
    by_m_s: float

    def words(self) -> str:
        """For the person who is asked whether the trial counts."""
        verb = "jumps" if len(self.beats) == 1 else "jump"
        return f"{spans(self.beats)} {verb} by {self.by_m_s * 1e3:+.0f} mm/s: a bump or a wave?"


def disturbance_of(trial: TrialSpeeds) -> Disturbance | None:
    """The largest one; None: there is none, or too little was measured to tell."""
    known = np.flatnonzero(trial.measured)
    if len(known) < _BEATS_MIN:
        return None
    try:
        off = _missed(trial)[known]
    except InputError:
        return None  # no fish moves like that; what else is wrong with it is said elsewhere
    jumps = np.diff(off)
    scatter = _MAD * float(np.median(np.abs(jumps)))
    sigma = float(np.median(trial.sigma_m_s[known]))
    at = int(np.argmax(np.abs(jumps)))
    if abs(jumps[at]) <= max(_JUMP_M_S, _SCATTERS * scatter, _SIGMAS * sigma):
        return None
    first, last = _extent(off, at)
    by_m_s = float(jumps[at]) if first == at + 1 else -float(jumps[at])
    return Disturbance(range(int(known[first]), int(known[last]) + 1), by_m_s)


def _missed(trial: TrialSpeeds) -> F64:
    """Speed less the model's, per beat."""
    known, used = trial.measured, trial.measured
    for _ in range(_FITS):
        found = fit([replace(trial, speed_m_s=np.where(used, trial.speed_m_s, np.nan))], _PLAIN)
        modelled = found.model.beats(trial.amplitude_rad, trial.beat_s, found.conditions[0])
        off: F64 = trial.speed_m_s - modelled
        usual = _MAD * float(np.median(np.abs(off[known])))
        fits = known & (np.abs(off) < max(_FITS_M_S, _FITS_MADS * usual))
        if np.array_equal(fits, used) or 2 * fits.sum() < known.sum():
            break
        used = fits
    return off


def _extent(off: F64, at: int) -> tuple[int, int]:
    """First and last of the beats on that side of the jump after ``at`` that is farther off."""
    after = abs(off[at + 1]) >= abs(off[at])
    begin, step = (at + 1, 1) if after else (at, -1)
    least = _FADED * abs(off[begin])
    end = begin
    while 0 <= end + step < len(off) and off[end + step] * np.sign(off[begin]) > least:
        end += step
    return min(begin, end), max(begin, end)


_STEADY_BEATS = 6  # of one amplitude, the later half of which is steady
_BATTERY_SPREAD_V = 0.4
_RMS_M_S = 0.003
# Half of the 95 % interval that is too much (relative for kappa and slope), and what narrows it.
_WIDE = {
    "kappa_per_m": (0.3, "a coast-down from a faster cruise narrows it"),
    "slope_m_s_rad": (0.1, "more trials near the largest amplitude narrow it"),
    "dead_zone_rad": (0.03, "a long cruise a little above it narrows it"),
    "delay_s": (0.15, "a trial whose amplitude changes gently, beat by beat, narrows it"),
}
NAMES = {
    "kappa_per_m": ("kappa (drag over mass)", "1/m"),
    "slope_m_s_rad": ("slope", "m/s/rad"),
    "dead_zone_rad": ("dead zone", "rad"),
    "delay_s": ("delay", "s"),
    "bend_per_rad": ("bend of the map", "1/rad"),
    "linear_drag_m_s": ("linear drag over quadratic", "m/s"),
    "wake_share": ("thrust that follows", ""),
    "wake_s": ("... with the time constant", "s"),
}


@dataclass(frozen=True)
class TrialAccount(TrialSpeeds):
    """A trial and what the model makes of it, with the trial's own start, flow and gain."""

    model_m_s: F64 = field(kw_only=True)

    @property
    def top_rad(self) -> float:
        """The largest amplitude."""
        return float(self.amplitude_rad.max())

    @property
    def way_m(self) -> float:
        """Measured way; beats without a speed as the model has them."""
        known = np.isfinite(self.speed_m_s)
        return float(np.where(known, self.speed_m_s, self.model_m_s).sum()) * self.beat_s


@dataclass(frozen=True)
class Account:
    """``steady``: (amplitude_rad, speed_m_s) of the steady parts of the trials. ``battery_v``:
    lowest and highest of the trials."""

    identified: Identified
    rms_m_s: float
    beats: int
    trials: list[TrialAccount]
    steady: tuple[F64, F64]
    battery_v: tuple[float, float] | None
    warnings: list[str]

    @property
    def battery_text(self) -> str:
        """Its range for people; empty when nobody measured it."""
        low, high = (f"{volt:.1f}" for volt in self.battery_v or (0.0, 0.0))
        if self.battery_v is None:
            return ""
        return f"{low} V" if low == high else f"{low} to {high} V"

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``: SI units, keys end in them."""
        known = self.identified
        battery = self.battery_v or (None, None)
        return {
            "source": known.source,
            "unique_id": known.unique_id,
            "model": vars(known.model),
            "band": known.band,
            "assumed": known.assumed,
            "alpha_kg_m": known.alpha_kg_m,
            "rms_m_s": self.rms_m_s,
            "beats": self.beats,
            "battery_min_v": battery[0],
            "battery_max_v": battery[1],
            "runs": [
                {
                    "trial": trial.trial,
                    "amplitude_max_rad": trial.top_rad,
                    "beats": len(trial.amplitude_rad),
                    "way_m": trial.way_m,
                    "battery_v": trial.battery_v,
                    "amplitude_rad": trial.amplitude_rad,
                    "speed_m_s": trial.speed_m_s,
                    "model_m_s": trial.model_m_s,
                }
                for trial in self.trials
            ],
            "warnings": self.warnings,
        }


def account_of(identified: Identified, prior: Prior | None = None) -> Account:
    """The account of a fish identified from trials, with the prior it was identified with."""
    trials = identified.trials
    found = fit(trials, prior, identified.scatter)
    accounts = [
        TrialAccount(
            **vars(trial), model_m_s=found.model.beats(trial.amplitude_rad, trial.beat_s, day)
        )
        for trial, day in zip(trials, found.conditions, strict=True)
    ]
    volts = [trial.battery_v for trial in trials if trial.battery_v is not None]
    battery = (min(volts), max(volts)) if volts else None
    return Account(
        identified=identified,
        rms_m_s=found.rms_m_s,
        beats=found.beats,
        trials=accounts,
        steady=steady_points(trials),
        battery_v=battery,
        warnings=_warnings(identified, found.rms_m_s, battery),
    )


def _warnings(
    identified: Identified, rms_m_s: float, battery: tuple[float, float] | None
) -> list[str]:
    found = [
        f"{NAMES[name][0]} is known to +-{wide:.2g} {unit} only; {remedy}"
        for name, (wide, unit, remedy) in _too_wide(identified).items()
    ]
    if rms_m_s > _RMS_M_S:
        found.append(
            f"the model misses the beats by {rms_m_s * 1e3:.1f} mm/s RMS. Look in the plot for "
            "what repeats, and whether something touched the fish"
        )
    if battery is not None and battery[1] - battery[0] > _BATTERY_SPREAD_V:
        found.append(
            f"the battery fell from {battery[1]:.1f} to {battery[0]:.1f} V; the slope is its mean"
        )
    return found


def _too_wide(identified: Identified) -> dict[str, tuple[float, str, str]]:
    """(half width, its unit, what to do) of every number known too badly, if data spoke of it."""
    found = {}
    for name, (most, remedy) in _WIDE.items():
        low, high = identified.band[name]
        relative = name in ("kappa_per_m", "slope_m_s_rad")
        value = getattr(identified.model, name)
        if (high - low) / 2 > most * (value if relative else 1) and name not in identified.assumed:
            found[name] = ((high - low) / 2, NAMES[name][1], remedy)
    return found


def steady_points(trials: Sequence[TrialSpeeds]) -> tuple[F64, F64]:
    """(amplitude_rad, speed_m_s) of every stretch of one amplitude long enough to be steady."""
    points = []
    for trial in trials:
        edges = np.flatnonzero(np.diff(trial.amplitude_rad)) + 1
        for stretch in np.split(np.arange(trial.beats), edges):
            later = stretch[(len(stretch) + 1) // 2 :]
            later = later[trial.measured[later]]
            if len(stretch) >= _STEADY_BEATS and later.size:
                points.append((trial.amplitude_rad[stretch[0]], trial.speed_m_s[later].mean()))
    table = np.array([p for p in points if p[0] > 0 and p[1] > STILL_M_S]).reshape(-1, 2)
    return table[:, 0], table[:, 1]


def with_drag(identified: Identified, fish: ThesisFish) -> Identified:
    """The same with the thesis's drag coefficient, where cruises were steady."""
    amplitude, speed = steady_points(identified.trials)
    if not amplitude.size:
        return identified
    return replace(identified, alpha_kg_m=fish.drag_kg_m(amplitude, speed))


def from_trials(paths: Sequence[Path]) -> tuple[Identified, bool]:
    """(what trials of one fish tell, whether it was a simulated one). Raises InputError."""
    if not paths:
        raise InputError("there are no trial files.", "Give some, or an experiment that has them.")
    trials = [read_trial(path) for path in paths]
    fish = {trial.unique_id for trial in trials}
    if len(fish) > 1:
        raise InputError(
            f"the trials are of {len(fish)} different boards.", "Give those of one fish."
        )
    speeds = [trial_speeds(trial) for trial in trials]
    used = [one for one in speeds if one.measured.any()]
    if not used:
        raise InputError(
            "no trial of these has a speed.", "Upload the speeds first: tailbeat trial speeds"
        )
    found = identify_trials(used, source="trials", unique_id=fish.pop())
    length_m = trials[0].params.get("FISH_LEN_M", ThesisFish.length_m)
    about = ThesisFish(length_m=length_m, beat_s=trials[0].beat_s)
    return with_drag(found, about), trials[0].board != "fish"


def steady_band(models: Sequence[FishModel], amplitude_rad: F64) -> tuple[F64, F64]:
    """95 % interval of the steady speed at each amplitude, m/s."""
    speeds = np.array([model.steady_m_s(amplitude_rad) for model in models])
    low, high = np.percentile(speeds, [2.5, 97.5], axis=0)
    return low, high
