"""What a diagnosis proposes, carried out when the operator accepts it; then the series goes on.

One function per cause. What a proposal needs of the operator beyond the one key (a limit's number,
a fish in the water) it asks for itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError
from tailbeat.core.reference import Reference, ReferenceLimits
from tailbeat.core.speed_source import Camera
from tailbeat.core.trial_checks import heading_drift
from tailbeat.experiment.current import held_reference, set_and_save
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.library import identified_if_readable, library_of
from tailbeat.learning.diagnosis import Cause, CauseFound
from tailbeat.learning.error_bound import suggest
from tailbeat.learning.fish_model import TrialSpeeds, trial_speeds
from tailbeat.learning.identification import Identified
from tailbeat.session.board_law import lower_gain
from tailbeat.session.commission import give_reference, store_measured
from tailbeat.session.decide import log_state, restore_best_and_log
from tailbeat.session.events import Operator, StepEnded
from tailbeat.session.guards import Guard
from tailbeat.session.health import check_health
from tailbeat.session.limit import limit_offer
from tailbeat.session.log import SessionLog
from tailbeat.session.measure import measure_fish
from tailbeat.session.options import Options
from tailbeat.session.series import Round, SeriesEnd, run_series

_COMMAND = "tailbeat start"


@dataclass
class Trials:
    """A series of trials, and what is proposed on the way. ``experiment``: gives the folder of the
    board's reference; ``folder``: the last one. ``steps``: what became of the proposals that were
    accepted."""

    fish: Fish
    operator: Operator
    options: Options
    experiment: Callable[[], Experiment]
    camera: Camera | None = None
    guard: Guard | None = None
    steps: list[StepEnded] = field(default_factory=list)
    folder: Experiment | None = field(default=None, init=False)

    def run(self) -> tuple[SeriesEnd, Experiment]:
        """Until the series ends by itself. Raises what ``run_series`` and the steps raise."""
        options, rounds = self.options, list[Round]()
        while True:
            self.folder = folder = self.experiment()
            end = run_series(self.fish, folder, self.operator, options, self.camera, self.guard)
            rounds += end.rounds
            if end.accepted is None:  # each cause is proposed once, so this comes
                return replace(end, rounds=rounds), folder
            step = CARRY_OUT[end.accepted.cause](self, end.accepted)
            self.steps.append(step)
            self.operator.tell(step)
            until = options.until.beyond(end.counted)
            anew = end.accepted.cause not in _GIVE_INPUT
            options = replace(options, plan_anew=anew, counted=end.counted, until=until)

    @property
    def reference(self) -> Reference:
        """The board's."""
        found = held_reference(self.fish)
        assert found is not None
        return found

    @property
    def identified(self) -> Identified | None:
        """What is known of the fish."""
        return identified_if_readable(library_of(self.fish))


def _raise_limit(of: Trials, finding: CauseFound) -> StepEnded:
    trials = SessionLog(of.folder).counting() if of.folder is not None else []
    straight = heading_drift(trials[-1]) if trials else None
    offer = limit_offer(of.fish.params.values(), of.reference, of.identified, straight)
    if isinstance(offer, str):
        return StepEnded("limit", False, offer)
    if not offer.is_typed_by(of.operator):
        return StepEnded("limit", False, f"{offer.name} stays {offer.was:.2f}, as answered")
    set_and_save(of.fish, {offer.name: offer.to})
    return StepEnded("limit", True, offer.text)


def _feasible(of: Trials, finding: CauseFound) -> StepEnded:
    identified, params = of.identified, of.fish.params.values()
    if identified is None:
        return StepEnded("reference", False, "the fish was not measured: tailbeat start")
    limits = ReferenceLimits.from_params(params)
    found = suggest(identified, of.reference, params["AMP_MAX_RAD"], limits)
    give_reference(of.fish, found.reference, of.operator)
    return StepEnded("reference", True, f"{found.reference.name}: {'; '.join(found.changes)}")


def _sensors(of: Trials, finding: CauseFound) -> StepEnded:
    return check_health(of.fish, of.camera, of.operator, _COMMAND)


def _best_again(of: Trials, finding: CauseFound) -> StepEnded:
    trials = SessionLog(of.folder).counting() if of.folder is not None else []
    best = next((one for one in reversed(trials) if one.number == finding.value), None)
    if best is None:
        restore_best_and_log(of.fish)
        return StepEnded("repeat", True, "the best input so far comes next, once more")
    of.fish.upload_amplitudes(best.beats.amplitude_rad)
    log_state(of.fish)
    return StepEnded("repeat", True, f"the input of trial {best.number} comes next, once more")


def _measure(of: Trials, finding: CauseFound) -> StepEnded:
    limits, known = of.options.wanted, _still_true(of, finding)
    measured = measure_fish(of.fish, of.reference, of.operator, of.camera, of.guard, limits, known)
    store_measured(of.fish, measured)
    return StepEnded("measure", True, "the fish was measured again; the next input is planned anew")


def _still_true(of: Trials, finding: CauseFound) -> tuple[TrialSpeeds, ...]:
    """What counts beside the new run: of a fish that changed what it has executed since, otherwise
    what it was measured by. (The trials of a model that misses go on to correct it.)"""
    if finding.cause is not Cause.CHANGED:
        return tuple(of.identified.trials) if of.identified else ()
    trials = [trial_speeds(one) for one in SessionLog(of.folder).counting()] if of.folder else []
    since = finding.value or 0.0
    return tuple(one for one in trials if one.measured.any() and one.trial >= since)


def _smaller_gain(of: Trials, finding: CauseFound) -> StepEnded:
    if finding.value is None:
        raise InputError("no smaller gain is known.", "tailbeat session design --set")
    lower_gain(of.fish, finding.value)
    restore_best_and_log(of.fish)
    return StepEnded("gain", True, f"ILC_GAIN is {finding.value:.2f}; the best input comes next")


_GIVE_INPUT = (Cause.DISTURBANCE,)  # what comes next is not planned by a law

CARRY_OUT: dict[Cause, Callable[[Trials, CauseFound], StepEnded]] = {
    Cause.SATURATION: _raise_limit,
    Cause.INFEASIBLE: _feasible,
    Cause.MISSING: _sensors,
    Cause.DISTURBANCE: _best_again,
    Cause.MISFIT: _measure,
    Cause.CHANGED: _measure,
    Cause.GAIN: _smaller_gain,
}
