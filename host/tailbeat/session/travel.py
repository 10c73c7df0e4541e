"""How far the fish will come with the amplitudes it is about to swim, and whether there is room."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike

from tailbeat.board.fish import Fish
from tailbeat.core import law as laws
from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError, Refused, TransferError
from tailbeat.core.faults import NO_REFERENCE, refusal
from tailbeat.core.law_memory import first_amplitudes
from tailbeat.core.records import INPUT_FIRST, decode_reference
from tailbeat.core.trial_file import Trial, read_trial
from tailbeat.experiment.library import TrialLibrary, identified_if_readable
from tailbeat.learning.fish_model import FishModel, trial_speeds
from tailbeat.learning.fit import Prior, farthest, fit, speeds_with_coast, travel_m
from tailbeat.learning.identification import Identified
from tailbeat.learning.planner import plan
from tailbeat.learning.scatter import Scatter
from tailbeat.link.ftp.wire import FtpError
from tailbeat.session.guards import Guard, GuardedTrial
from tailbeat.session.identify import prior_of
from tailbeat.session.outcome import Travel

_TELLING_M = 0.1  # a trial that came less far says nothing of a longer one
_MISS = 2.0  # the rest of a miss, after the fit, beyond which it was no swim like this one
_had: WeakKeyDictionary[Fish, Trial] = WeakKeyDictionary()  # fetched last, by this connection


@dataclass(frozen=True)
class TravelModel:
    """What is believed of a fish: a model, its covariance (as of a Fit) and how swims
    scatter. ``more``: how much farther it comes than the model says. ``by``: where from."""

    model: FishModel
    covariance: F64
    scatter: Scatter
    by: str
    more: float = 1.0

    @property
    def coasts_by_per_m(self) -> float:
        """The drag, a sigma less of it than believed: what a fish may coast by."""
        sigma = math.sqrt(float(self.covariance[0, 0]))
        return self.model.kappa_per_m * math.exp(-sigma)

    def speeds(self, amplitude_rad: ArrayLike, beat_s: float) -> F64:
        """Mean speed of each beat and of the coast after the last one, m/s."""

        return self.more * speeds_with_coast(self.model, amplitude_rad, beat_s)


def travel_model_of(
    params: Mapping[str, float], identified: Identified | None = None, last: Trial | None = None
) -> TravelModel:
    """The identified fish, else that of MDL_..., as wide as for any fish; then what the trial
    ``last`` teaches of it. A trial of which too little was measured teaches nothing."""

    if identified is not None:
        sigma = np.sqrt(np.diag(identified.whole_covariance))
        prior = Prior(identified.model, *map(float, sigma))
        known = identified.model, identified.whole_covariance, identified.scatter
        by = "the identified fish"
    else:
        prior = prior_of(dict(params))
        known = prior.model, prior.covariance, Scatter()
        by = "the board's model"
    before = TravelModel(*known, by)
    if last is None:
        return before
    trial = trial_speeds(last)
    swum_m = float(np.nansum(trial.speed_m_s)) * trial.beat_s
    if 2 * np.count_nonzero(trial.measured) < last.executed_beats or swum_m < _TELLING_M:
        return before
    found = fit([trial], prior, before.scatter)
    # That trial's own gain, flow and start will not come again; what the fit leaves over will.
    speed = found.model.beats(trial.amplitude_rad, trial.beat_s, found.conditions[0])
    expected_m = float(np.sum(speed[trial.measured])) * trial.beat_s
    more = swum_m / expected_m if expected_m > 0 else math.inf
    by = f"{by} and trial {last.number}"
    if not 1 / _MISS <= more <= _MISS:
        return before
    return TravelModel(found.model, found.covariance, before.scatter, by, more)


def travel_by(
    belief: TravelModel, amplitude_rad: ArrayLike, params: Mapping[str, float], beat_s: float
) -> Travel:
    """As ``travel_of``, by what is believed of the fish."""

    recorded = np.clip(np.asarray(amplitude_rad, dtype=np.float64), 0.0, params["AMP_MAX_RAD"])
    expected_m = float(np.sum(belief.speeds(recorded, beat_s))) * beat_s
    edge, day = farthest(belief.model, belief.covariance, belief.scatter, recorded, beat_s)
    worst_m = belief.more * travel_m(edge, recorded, beat_s, day)
    return Travel(expected_m, max(worst_m, expected_m), room_m(params), belief.by)


def room_m(params: Mapping[str, float]) -> float:
    """The tank's length less the fish's; infinite when the tank is not checked."""
    tank_m = params["TANK_LEN_M"]
    return tank_m - params["FISH_LEN_M"] if tank_m > 0 else math.inf


def travel_of(
    amplitude_rad: ArrayLike,
    params: Mapping[str, float],
    beat_s: float,
    identified: Identified | None = None,
    last: Trial | None = None,
) -> Travel:
    """Of amplitudes as swum (cut at AMP_MAX_RAD here; DU_MAX_RAD acts when the board learns, not
    when it swims). With ``identified`` by that model; without by the thrust model of MDL_*.
    ``last``: a measured trial of the same fish; what it came farther, or less far, than the model
    says of its own amplitudes is expected again."""
    return travel_by(travel_model_of(params, identified, last), amplitude_rad, params, beat_s)


def travel_next(fish: Fish, book: TrialLibrary | None, planned: bool = False) -> Travel:
    """Of what the board will swim next, by the best that is known of it. Raises Refused without a
    reference. Nothing on the board changes: before the first arming the amplitudes are those that
    arming will compute; ``planned``: those of an identified fish that its model will plan."""
    following = _next(fish, book, planned)
    return travel_by(following.belief, following.amplitude_rad, following.params, following.beat_s)


def guarded_trial(
    fish: Fish,
    book: TrialLibrary | None,
    caller: Guard | None = None,
    abort_requested: Callable[[], bool] = lambda: False,
) -> GuardedTrial:
    """What the guards of the board's next trial are made from, by the same knowledge."""
    following = _next(fish, book)
    return GuardedTrial(
        following.params,
        following.belief.speeds(following.amplitude_rad, following.beat_s),
        abort_requested,
        caller,
        following.beat_s,
        following.belief.coasts_by_per_m,
    )


@dataclass(frozen=True)
class _Next:
    """What swims next, as swum, and what is believed of who swims it."""

    amplitude_rad: F64
    beat_s: float
    params: dict[str, float]
    belief: TravelModel


def _next(fish: Fish, book: TrialLibrary | None, planned: bool = False) -> _Next:

    record = fish.reference_record()
    if record is None:
        raise refusal(NO_REFERENCE)
    wanted = decode_reference(record)
    params = fish.params.values()
    law = laws.Law.from_params(params, wanted.beat_s)
    held = fish.amplitudes() if fish.status().iteration else None
    identified, limit = identified_if_readable(book), params["AMP_MAX_RAD"]
    if held is not None and held.input != INPUT_FIRST:
        values = held.values
    elif planned and identified is not None:
        found = plan(identified.model, wanted.speed_m_s, wanted.beat_s, limit)
        values = found.amplitude_rad.astype(np.float32)
    else:
        values = first_amplitudes(law, wanted.speed_m_s)
    amplitude = laws.saturate(law, values).astype(np.float64)
    belief = travel_model_of(params, identified, last_measured(fish, book))
    return _Next(amplitude, wanted.beat_s, params, belief)


def last_measured(fish: Fish, book: TrialLibrary | None) -> Trial | None:
    """The trial the board learned from last, else the last of the trial library that counts, is of
    no identification and has speeds. One that the trial library lacks is fetched, once."""
    number = fish.status().last_learned_trial
    counting = [one.trial for one in book.kept()[0] if not one.mark] if book is not None else []
    measured = [trial for trial in counting if np.isfinite(trial.beats.speed_m_s).any()]
    if number is not None and number not in [trial.number for trial in measured]:
        with contextlib.suppress(Refused, InputError, TransferError, FtpError):
            return _fetched(fish, number)
    return measured[-1] if measured else None


def _fetched(fish: Fish, number: int) -> Trial:
    held = _had.get(fish)
    if held is None or held.number != number:
        with TemporaryDirectory() as folder:
            held = read_trial(fish.pull_trial(number, Path(folder)))
        _had[fish] = held
    return held
