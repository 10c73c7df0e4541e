"""What a diagnosis proposes: told after the trial, carried out when the operator says yes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from tailbeat.board.fish import Fish, board_reference
from tailbeat.core.reference import thesis
from tailbeat.experiment.current import begin, set_and_save
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.library import identified_if_readable, library_of
from tailbeat.learning import fit
from tailbeat.learning.diagnosis import Cause, CauseFound
from tailbeat.learning.saturation import up_to_grain
from tailbeat.session.commission import give_reference
from tailbeat.session.events import Event, StepEnded, TrialDiagnosed, TrialStarted
from tailbeat.session.limit import LimitIncrease
from tailbeat.session.log import SessionLog
from tailbeat.session.options import Options, Until
from tailbeat.session.outcome import Decision, RecordedTrial
from tailbeat.session.proposals import CARRY_OUT, Trials
from tailbeat.session.start import StartOptions, run_start
from tailbeat.sim.board import SimBoard, SimTransport

ONE = Options(until=Until(1), wanted=None)


@pytest.fixture(autouse=True)
def quickly(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Without a bootstrap, which takes seconds and is tested elsewhere."""
    monkeypatch.setattr(fit, "bootstrap", lambda *_, **__: [])
    monkeypatch.setenv("TAILBEAT_LOGBOOK", str(tmp_path / "library"))
    monkeypatch.chdir(tmp_path)


@dataclass
class Answers:
    """``agrees``: to a question; ``number``: typed, None = what is offered."""

    agrees: Callable[[str], bool] = lambda _: True
    typed: float | None = None
    told: list[Event] = field(default_factory=list)
    asked: list[str] = field(default_factory=list)

    def tell(self, event: Event) -> None:
        self.told.append(event)

    def wants_abort(self) -> bool:
        return False

    def decide(self, recorded: RecordedTrial) -> Decision:
        return Decision("keep")

    def confirm(self, question: str) -> bool:
        self.asked.append(question)
        return self.agrees(question)

    def number(self, question: str, value: float) -> float | None:
        return value if self.typed is None else self.typed


@dataclass
class Measured:
    """A fish that was commissioned; ``run`` runs trials with proposals."""

    fish: Fish
    folders: list[Experiment] = field(default_factory=list)

    def folder(self) -> Experiment:
        self.folders.append(begin(self.fish, Path("experiments")))
        return self.folders[-1]

    def run(self, operator: Answers, trials: int = 3, proposes: bool = True) -> Trials:
        options = Options(until=Until(trials), wanted=None, proposes=proposes)
        of = Trials(self.fish, operator, options, self.folder)
        of.run()
        return of

    def limit(self, rad: float | None = None) -> float:
        if rad is not None:
            set_and_save(self.fish, {"AMP_MAX_RAD": rad})
        return self.fish.params.get("AMP_MAX_RAD").value


@pytest.fixture
def measured(tmp_path: Path) -> Measured:
    fish = Fish(SimTransport(SimBoard("tank", seed=11)))
    found = Measured(fish)
    with pytest.MonkeyPatch.context() as path:
        path.chdir(tmp_path)
        run_start(fish, Answers(), StartOptions(series=ONE), found.folder)
    return found


def causes(operator: Answers) -> list[Cause]:
    return [
        one.causes[0].cause
        for one in operator.told
        if isinstance(one, TrialDiagnosed) and one.causes
    ]


def test_a_limit_that_costs_error_is_raised_by_its_number(measured: Measured) -> None:
    high_rad, low_rad = measured.limit(), 0.35
    measured.fish.link.run(20.0)  # it rests before its trial, so that the IMU tells its heading
    measured.limit(low_rad)
    operator = Answers()
    of = measured.run(operator, 1)
    assert (
        causes(operator)[0] is Cause.SATURATION and "raise the amplitude limit" in operator.asked[0]
    )
    assert [one.name for one in of.steps] == ["limit"] and of.steps[0].done, of.steps[0].words
    assert low_rad < measured.limit() <= high_rad
    swum = sum(isinstance(one, TrialStarted) for one in operator.told)
    assert swum == 2, "the trial that showed it, and one with the new limit"


@pytest.mark.parametrize("hundredths", range(50, 100))
def test_every_limit_is_allowed_by_the_number_that_is_shown(hundredths: int) -> None:
    to = up_to_grain(hundredths / 100 - 0.003)
    offer = LimitIncrease("AMP_MAX_RAD", 0.5, to, "")
    shown = f"{to:g}"
    assert float(shown) == to and offer.is_typed_by(Answers(typed=float(shown)))
    assert not offer.is_typed_by(Answers(typed=to + 0.01))


def test_trials_before_a_proposal_count(measured: Measured) -> None:
    measured.limit(0.35)
    operator = Answers()
    end, _ = Trials(
        measured.fish,
        operator,
        Options(until=Until(3), wanted=None, proposes=True),
        measured.folder,
        steps=[StepEnded("health", True, "")] * 8,
    ).run()
    executed = sum(isinstance(one, TrialStarted) for one in operator.told)
    assert executed == len(end.rounds) == end.counted == 3 and end.why == "swims"


def test_another_number_raises_nothing(measured: Measured) -> None:
    measured.limit(0.35)
    of = measured.run(Answers(typed=0.5), 1)
    assert [one.done for one in of.steps] == [False] and measured.limit() == pytest.approx(0.35)


def test_no_is_an_answer_for_the_rest_of_the_series(measured: Measured) -> None:
    measured.limit(0.35)
    operator = Answers(agrees=lambda _: False)
    of = measured.run(operator, 3)
    assert len(operator.asked) == 1 and of.steps == [] and len(causes(operator)) == 3


def test_with_nobody_to_ask_it_is_only_told(measured: Measured) -> None:
    measured.limit(0.35)
    operator = Answers()
    measured.run(operator, 2, proposes=False)
    assert operator.asked == [] and causes(operator)[0] is Cause.SATURATION
    entry = measured.folders[-1].journal.entries("diagnosis")[-1]
    assert entry["causes"][0]["cause"] == "saturation" and entry["causes"][0]["proposal"]


def test_every_proposal_can_be_carried_out(measured: Measured) -> None:
    """On a fish that is well, whatever it is named for; then trials go on."""
    operator, fish = Answers(), measured.fish
    measured.limit(0.6)
    for cause in Cause:
        give_reference(fish, thesis(), operator)
        of = Trials(fish, operator, ONE, measured.folder)
        of.run()
        before = identified_if_readable(library_of(fish))
        step = CARRY_OUT[cause](of, CauseFound(cause, 0.01, "", "", "", 2.5))
        assert isinstance(step, StepEnded) and step.words
        assert step.done or cause is Cause.SATURATION, step.words
        after = identified_if_readable(library_of(fish))
        assert before is not None and after is not None
        assert (before.model != after.model) == (cause in (Cause.MISFIT, Cause.CHANGED))
        reference = board_reference(fish)
        assert reference is not None
        assert (reference.crc != thesis().crc) == (cause is Cause.INFEASIBLE)
        of.run()
    assert fish.params.get("ILC_GAIN").value == pytest.approx(2.5)


def test_the_input_of_the_named_trial_comes_next(measured: Measured) -> None:
    """Whichever it is, and the next trial executes it: no law plans in between."""
    of = measured.run(Answers(), 2, proposes=False)
    first, last = SessionLog(measured.folders[-1]).counting()[-2:]
    assert (first.beats.amplitude_rad != last.beats.amplitude_rad).any()
    cause = CauseFound(Cause.DISTURBANCE, 0.01, "", "", "", float(first.number))
    step = CARRY_OUT[Cause.DISTURBANCE](of, cause)
    assert step.done and f"trial {first.number}" in step.words
    measured.run(Answers(), 1, proposes=False)
    repeated = SessionLog(measured.folders[-1]).counting()[-1]
    assert repeated.number > last.number
    assert (repeated.beats.amplitude_rad == first.beats.amplitude_rad).all()
