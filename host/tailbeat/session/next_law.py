"""Which law makes the next input: the P law on the board, or the model-based law on this computer.

By default the model-based law, from the trial on that a model predicts: of a fish whose runs were
measured at once; of another one once a model fitted to its trials foresees with 95 % probability
that its input does better than the first trial did. Until then, after a misfit, and on request, the
board's own step stands. The board makes that step after every trial all the same, so it goes on by
itself should this computer fail.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError
from tailbeat.core.printable import mm
from tailbeat.core.records import INPUT_RESTORED, INPUT_UPLOADED, Amplitudes, decode_learned
from tailbeat.core.reference import Reference
from tailbeat.core.trial_file import Trial
from tailbeat.experiment.folder import copy_state, held_state
from tailbeat.experiment.library import identified_if_readable, library_of
from tailbeat.learning.assessment import rollback_words
from tailbeat.learning.belief import Beliefs
from tailbeat.learning.diagnosis import Evidence, diagnose
from tailbeat.learning.fish_model import TrialSpeeds, trial_speeds
from tailbeat.learning.identification import any_fish
from tailbeat.link.messages import LearnReport
from tailbeat.session.events import InputChosen, TrialDiagnosed
from tailbeat.session.limit import allowed_rad
from tailbeat.session.log import SessionLog
from tailbeat.session.next_input import (
    ModelStep,
    choose_next_input,
    next_step,
    setting_of,
    trials_since,
    upload,
)

LawName = Literal["auto", "model", "p"]
ON_REQUEST = "on request"


@dataclass
class NextLaw:
    """The law of one series. It learns from all trials in the fish's library, or without one from
    those of ``log``. ``wanted``: ``auto`` = as above."""

    fish: Fish
    log: SessionLog
    wanted: LawName = "auto"
    _beliefs: Beliefs | None = field(default=None, init=False)

    def begin(self, anew: bool = False) -> InputChosen:
        """Before the first trial of a series: plans it where nothing has been learned yet, and
        where the board has made a step by itself since. What was uploaded or is to be repeated
        (unless ``anew``) or restored stays."""
        held, kept = self.fish.amplitudes(), None
        if not anew or held.input == INPUT_RESTORED:
            kept = self._uploaded(held) or _KEPT.get(held.input or 0) or self._repeated(held)
        return self._noted(kept or self._chosen(restored=False))

    def after(self, report: LearnReport) -> InputChosen:
        """After the board has learned from a trial; it has the next input when this returns."""
        return self._noted(self._chosen(report.rolled_back))

    def _uploaded(self, held: Amplitudes) -> InputChosen | None:
        """What the event log has of an uploaded input; None: it is another one."""
        copy = held_state(self.log.experiment)
        if held.input != INPUT_UPLOADED or copy is None or not copy.learned:
            return None
        same = decode_learned(copy.learned).amplitude_rad.tobytes() == held.values.tobytes()
        return self.log.chosen_for(self.fish.status().next_trial) if same else None

    def _repeated(self, held: Amplitudes) -> InputChosen | None:
        """Where the last decision was to execute the same amplitudes again, and the board still has
        them, made by its own law."""
        trial = self.log.to_repeat()
        if trial is None or trial.reference_crc != held.reference_crc:
            return None
        input_rad = trial.beats.amplitude_rad
        known = np.isfinite(input_rad)
        if not np.array_equal(held.values[known], input_rad[known]):
            return None
        return InputChosen("p", f"the input of trial {trial.number} once more, as it was decided")

    def diagnose_last(self, made_by: str) -> TrialDiagnosed | None:
        """What explains the error of the last trial that was learned from; ``made_by``: the law of
        its input. In the event log too. None when the model cannot tell."""
        trials = self.log.counting()
        try:
            evidence = self._evidence(made_by, trials)
        except InputError:
            return None
        if evidence is None:
            return None
        found = TrialDiagnosed(trials[-1].number, tuple(diagnose(evidence)))
        if found.causes:
            self.log.diagnosed(found)
        return found

    def _evidence(self, made_by: str, trials: Sequence[Trial]) -> Evidence | None:
        """None where no trial of the reference has a speed."""
        beliefs, setting = self._known(), setting_of(self.fish)
        crc = setting.reference.crc
        speeds = [trial_speeds(trial) for trial in trials]
        speeds = [one for one in speeds if one.reference_crc == crc and one.measured.any()]
        if not speeds:
            return None
        known = trials_since(beliefs.identified, self._trials(), self.fish.unique_id())
        return Evidence(
            setting.reference,
            setting.amplitude_max_rad,
            speeds,
            beliefs.after(known),
            setting.law if made_by == "p" else None,
            max(allowed_rad(beliefs.identified, trials[-1].params), setting.amplitude_max_rad),
        )

    def _noted(self, chosen: InputChosen) -> InputChosen:
        """In the event log, with the copy of what the board has now."""
        self.log.chosen(chosen, self.fish.status().next_trial)
        copy_state(self.fish, self.log.experiment)
        return chosen

    def _chosen(self, restored: bool) -> InputChosen:
        """Where the model has no answer the board's own step stands."""
        if self.wanted == "p":
            return _restored_or_p(restored, ON_REQUEST)
        try:
            return self._by_the_model(restored)
        except InputError as error:
            return _restored_or_p(restored, str(error))

    def _by_the_model(self, restored: bool) -> InputChosen:
        beliefs = self._known()
        trials = trials_since(beliefs.identified, self._trials(), self.fish.unique_id())
        if self.wanted == "auto" and beliefs.identified.source == "none" and not trials:
            return InputChosen("p", "nothing has been measured of this fish yet")
        setting = setting_of(self.fish)
        step = next_step(setting, beliefs, trials)
        if why := self._not_yet(step, setting.reference, trials):
            return _restored_or_p(restored, why)
        best_m_s = self.fish.status().best_max_abs_error_m_s
        following = choose_next_input(step.proposal, restored, best_m_s)
        if not following.upload:
            return InputChosen("best", following.words)
        if (book := library_of(self.fish)) is not None:
            book.add_proposal(step.document)
        upload(self.fish, setting, step.proposal)
        expected = step.proposal.predicted_max_abs_error_m_s
        return InputChosen(step.proposal.law, step.proposal.reason, expected)

    def _trials(self) -> list[TrialSpeeds]:
        """Oldest first."""
        if (book := library_of(self.fish)) is not None:
            return book.speeds()
        known = [trial_speeds(trial) for trial in self.log.counting()]
        return [trial for trial in known if trial.measured.any()]

    def _known(self) -> Beliefs:
        """Made anew when the fish has been identified meanwhile."""
        identified = identified_if_readable(library_of(self.fish)) or any_fish()
        held = self._beliefs
        if held is None or held.identified.made != identified.made:
            self._beliefs = held = Beliefs(identified)
        return held

    def _not_yet(self, step: ModelStep, reference: Reference, trials: Sequence[TrialSpeeds]) -> str:
        """Why the board's own step stands; empty = the model's input takes its place."""
        if step.proposal.law == "p":
            return step.proposal.reason
        if self.wanted == "model" or step.document["identified"]["source"] != "none":
            return ""
        low, _, high = step.proposal.predicted_max_abs_error_m_s
        if high < _first_error(reference, trials):
            return ""
        count = f"{len(trials)} trial{'s' if len(trials) > 1 else ''}"
        return (
            f"a model fitted to {count} does not predict less than the first trial had:"
            f" {mm(low)} to {mm(high)} mm/s"
        )


_KEPT = {
    INPUT_UPLOADED: InputChosen("model", "uploaded before"),
    INPUT_RESTORED: InputChosen("best", "restored"),
}


def _restored_or_p(restored: bool, why: str) -> InputChosen:
    """The board's own step."""
    return InputChosen("best", f"{rollback_words()}; {why}") if restored else InputChosen("p", why)


def _first_error(reference: Reference, trials: Sequence[TrialSpeeds]) -> float:
    """max|e| of the first trial of the reference; that of a tail at rest without one."""
    of_it = [t for t in trials if t.reference_crc == reference.crc and t.measured.any()]
    speed = of_it[0].speed_m_s if of_it else np.zeros(reference.beats)
    return float(np.nanmax(np.abs(reference.speed_m_s - speed)))
