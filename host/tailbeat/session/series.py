"""A series of trials: checks, trial, log, decision, learning, until the end that was asked for."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta

from tailbeat.board.fish import Fish
from tailbeat.core.errors import InputError, Refused
from tailbeat.core.faults import ABORT_COMMAND, BATTERY_CRITICAL, BATTERY_LOW, REBOOT, fault_info
from tailbeat.core.speed_source import Camera
from tailbeat.experiment.current import require_expected, require_own, require_same
from tailbeat.experiment.folder import Experiment, alone, copy_state, require_not_lost
from tailbeat.experiment.library import library_of
from tailbeat.experiment.redo import write_redo
from tailbeat.learning.convergence import Assessment
from tailbeat.learning.diagnosis import CauseFound
from tailbeat.link.messages import LearnReport
from tailbeat.session.collect import (
    STOPPED,
    TrialSetup,
    dangerous,
    drop_peeked,
    execute,
    keep_log,
    make_safe,
    peek_log,
    record_of,
    recover_trial,
    require_still,
    settled,
    stop_words,
)
from tailbeat.session.decide import DecisionResult, Decisions
from tailbeat.session.events import InputChosen, Notice, Operator, TrialRecorded
from tailbeat.session.guards import Guard, GuardedTrial
from tailbeat.session.log import (
    RESUME_COMMAND,
    SessionLog,
    accepted,
    forecast,
    held_before,
    switched_off_since,
    too_low,
)
from tailbeat.session.missed import fetch_missed
from tailbeat.session.next_law import NextLaw
from tailbeat.session.options import Options
from tailbeat.session.outcome import BY_HAND, Decision, Ready, RecordedTrial
from tailbeat.session.preflight import prepare
from tailbeat.session.preflight_step import BatteryLow, GivenUp, PreflightLimits, countdown
from tailbeat.session.status import assess_series
from tailbeat.session.travel import guarded_trial, travel_next
from tailbeat.session.trial_camera import camera_of

NOTHING_MORE = "swims"  # why a series ends after as many trials as were asked for
GOES_ON = "nothing is lost, the same command goes on from here"
BY_CTRL_C = f"stopped by Ctrl-C; {GOES_ON}"


@dataclass(frozen=True)
class Round:
    """One trial and what became of it. ``learned`` None: nothing was learned. ``causes``: what
    explains its error, the most important cause first."""

    recorded: RecordedTrial
    decision: Decision
    learned: LearnReport | None
    causes: tuple[CauseFound, ...] = ()


@dataclass(frozen=True)
class SeriesEnd:
    """``why``: ``swims`` (as many trials as were asked for), ``converged``, ``saturated`` (nothing
    more to gain at the amplitude limit), ``battery``, ``interrupted`` (Ctrl-C or the operator),
    ``stopped`` (the board stopped by a rule of its own and is left so, with its reason), or
    ``proposal`` (``accepted`` is to be carried out). ``counted``: trials that count for the end,
    those before this series included."""

    why: str
    words: str
    rounds: list[Round]
    verdict: Assessment | None
    accepted: CauseFound | None = None
    counted: int = 0

    @property
    def text(self) -> str:
        """How it ended, in words."""
        return f"ended{'' if self.why == NOTHING_MORE else f' ({self.why})'}: {self.words}"

    @property
    def records(self) -> list[RecordedTrial]:
        """The trials, in order."""
        return [one.recorded for one in self.rounds]


def run_series(
    fish: Fish,
    experiment: Experiment,
    operator: Operator,
    options: Options,
    camera: Camera | None = None,
    guard: Guard | None = None,
) -> SeriesEnd:
    """Swims until ``options.until``. The experiment must be of this fish and of the board's
    reference (``require_same``). Order of every round: a trial that still waits on the board is
    decided first; preflight checks; swim; its log pulled into the raw files; the decision, logged;
    only then the board learns or discards; its state copied (``experiment.board``). So whatever
    fails on the way (disk full, link gone, Ctrl-C) the next call goes on where this one stopped and
    nothing is lost.

    Raises InputError, and touches nothing, when the board holds what is not its own (a trim or a
    repeat that was broken off), has lost what the copy of its state knows, has other parameters
    than it is meant to have (``experiment.meant``), or another program swims in this experiment. A
    board that was switched off and has all that needs an operator's consent: the fish may have
    shifted.

    A trial stopped by the operator is decided on like any other; then the series ends. Raises what
    the preflight checks, the trial and the disk raise; the tail is still then."""
    require_own(fish)
    require_same(fish, experiment)
    with alone(experiment):
        require_still(fish)
        if not options.of_best:
            _require_no_repeat(experiment)
        require_not_lost(fish, experiment)
        require_expected(fish, experiment)
        if options.typed:
            experiment.journal.add("typed", command=options.typed)
        around = TrialSetup(fish, operator, camera, guard, options.reconnect_s)
        log = SessionLog(experiment)
        decisions = Decisions(fish, operator, log, options.learn)
        law = NextLaw(fish, log, options.law)
        return _run_safely(_Series(around, log, options, decisions, law), fish)


def _require_no_repeat(experiment: Experiment) -> None:
    if held_before(experiment) is not None:
        raise InputError(
            "a repeat of the best after a battery swap was interrupted. The board still holds the"
            " best input in place of the next one.",
            f"To finish it: {RESUME_COMMAND}",
        )


def _run_safely(series: _Series, fish: Fish) -> SeriesEnd:
    """The tail is still when this returns or raises."""
    try:
        return series.run()
    except GivenUp as given_up:
        make_safe(fish)
        return series.end("interrupted", str(given_up))
    except KeyboardInterrupt as interrupt:
        make_safe(fish)
        return series.end("interrupted", f"{interrupt}; {GOES_ON}" if str(interrupt) else BY_CTRL_C)
    except BaseException:
        make_safe(fish)
        raise


@dataclass
class _Series:
    """State of one call of run_series."""

    around: TrialSetup
    log: SessionLog
    options: Options
    decisions: Decisions
    law: NextLaw
    rounds: list[Round] = field(default_factory=list)
    counted: int = field(default=0, init=False)
    verdict: Assessment | None = None
    yaw_deg: float | None = None  # of the first start, for the preflight checks to compare with
    chosen: InputChosen | None = None  # of the input that comes next

    def __post_init__(self) -> None:
        self.counted = self.options.counted

    def end(self, why: str, words: str) -> SeriesEnd:
        write_redo(self.log.experiment)
        return SeriesEnd(why, words, self.rounds, self.verdict, counted=self.counted)

    def run(self) -> SeriesEnd:
        self._fetch_missed()
        end = self._catch_up() or self._enough()
        while end is None:
            end = self._battery() or self._switched_off() or self._round() or self._enough()
        return end

    def _catch_up(self) -> SeriesEnd | None:
        """What an earlier call, or somebody else, has left: a trial that waits, a stopped board,
        something learned that was not written down."""
        fish, open_trial = self.around.fish, self.log.open_trial()
        if fish.status().state == "ARMED":
            fish.disarm()
        status = settled(fish, open_trial)
        begun = open_trial is not None and open_trial < status.next_trial
        number = status.pending_trial or (open_trial if begun else None)
        if status.pending_trial is None:
            self._write_down_owed(status.last_learned_trial)
        if number is not None and (number == status.pending_trial or self._was_left(number)):
            where = "waits on the board" if number == status.pending_trial else "was left undecided"
            self._notice(f"trial {number} {where}; it is decided on first")
            return self._finish_old(number, begun and number == open_trial)
        last = open_trial is not None and open_trial >= status.next_trial - 1
        if last and status.fault.number == ABORT_COMMAND:
            fish.clear()  # it was stopped before its first beat, most likely from here
        return self._cleared()

    def _fetch_missed(self) -> None:
        """What the board executed without this computer."""
        if words := fetch_missed(self.around.fish, self.log):
            self._notice(words)

    def _switched_off(self) -> SeriesEnd | None:
        """Before each trial: the hull may have been open, and whether the best is repeated first is
        the operator's to say. Before there is a best nothing can tell a shift."""
        fish, journal = self.around.fish, self.log.journal
        require_expected(fish, self.log.experiment)
        if self.options.of_best or fish.status().best_iteration is None:
            return None
        if (trial := switched_off_since(fish, journal)) is None:
            return None
        words = f"the board was switched off since trial {trial}, and the fish may have shifted."
        if not self.around.operator.confirm(f"{words} Go on without a repeat of the best?"):
            return self.end("stopped", f"{words} Then: {RESUME_COMMAND}")
        accepted(fish, journal)
        return None

    def _finish_old(self, number: int, begun_here: bool) -> SeriesEnd | None:
        fish = self.around.fish
        made = self.log.chosen_for(number) if begun_here else None
        recorded = recover_trial(fish, self.log, number)
        self.around.operator.tell(TrialRecorded(recorded, made))
        status = fish.status()
        if recorded.measured_beats and number not in (
            status.pending_trial,
            status.last_learned_trial,
        ):
            self._gone(recorded)
        decision = self.decisions.decide(recorded)
        status = fish.status()
        if dangerous(status.fault) and (end := self._cleared()) is not None:
            return end
        return self._settle(recorded, decision, made, counts=False)

    def _gone(self, recorded: RecordedTrial) -> None:
        """It could have been learned from, and does not wait any more: somebody has dropped it."""
        if self.log.decision_on(recorded.file) is None:
            self.log.decided(recorded, Decision("discard", "dropped by another program"))

    def _cleared(self) -> SeriesEnd | None:
        """The board is not stopped, or the operator lets it go on."""
        status = self.around.fish.status()
        if status.state not in STOPPED:
            return None
        words = stop_words(status)
        if not self.around.operator.confirm(f"{words} Clear it and go on?"):
            return self.end("stopped", f"{words} Then: tailbeat board clear")
        self.around.fish.clear()
        return None

    def _was_left(self, number: int) -> bool:
        """Whether the board has the log of the trial that was begun last; one that another program
        swam in its place, or before it, is none of this experiment's."""
        if not self._has_log(number):
            return False
        fish, experiment = self.around.fish, self.log.experiment
        if self.log.is_begun(peek_log(fish, experiment, number)):
            return True
        drop_peeked(experiment, number)
        self.log.void(number, "another trial")
        self._notice(f"trial {number} on the board is not the one that was begun here; it is left")
        return False

    def _has_log(self, number: int) -> bool:
        return any(trial.number == number for trial in self.around.fish.trials())

    def _write_down_owed(self, last_learned: int | None) -> None:
        owed = self.log.owed()
        if owed is not None and owed == last_learned:
            report = self.around.fish.learn(owed)  # said again it only tells what it learned
            self.decisions.write_down(report)
            copy_state(self.around.fish, self.log.experiment)

    def _enough(self) -> SeriesEnd | None:
        """Whether the series has reached its end."""
        until, verdict = self.options.until, self.verdict
        if until.trials is not None and self.counted >= until.trials:
            plural = "" if self.counted == 1 else "s"
            return self.end(NOTHING_MORE, f"{self.counted} trial{plural}")
        if until.converged and verdict is not None and verdict.stop:
            why = "converged" if verdict.saturation is None else "saturated"
            return self.end(why, f"{verdict.stop_reason}: {verdict.advice}")
        pending = self.around.fish.status().pending_trial
        if pending is None:
            return None
        words = f"trial {pending} is kept and waits to be learned from: tailbeat trial learn"
        if self.counted == 0:
            raise InputError(
                words.rpartition(":")[0], "tailbeat trial learn, or go on without --no-learn"
            )
        return self.end(NOTHING_MORE, words)

    def _battery(self) -> SeriesEnd | None:
        """Before each trial: whether the battery still allows it."""
        fish = self.around.fish
        now_v = fish.status().battery_v
        params = fish.params.values("BATT_LOW_V", "BATT_CRIT_V")
        if (words := too_low(now_v, params)) is not None:
            return self.end("battery", f"{words}; change it, then: {RESUME_COMMAND}")
        if (words := forecast(now_v, self.log.drains(), params)) is not None:
            self._notice(words)
        return None

    def _round(self) -> SeriesEnd | None:
        try:  # nobody reads the camera's pictures while the operator decides
            with camera_of(self.around.fish, self.around.camera) as camera:
                around = replace(self.around, camera=camera)
                swam = self._swim(around, *self._prepare(around))
        except BatteryLow as low:
            return self.end("battery", f"{low}")
        except Refused as refused:
            if refused.number != BATTERY_LOW:
                raise
            return self.end("battery", f"{refused}")
        if isinstance(swam, SeriesEnd):
            return swam
        recorded, by_hand = swam
        decision = self.decisions.decide(recorded)
        end = self._settle(recorded, decision, self.chosen, counts=True)
        if end is None and recorded.outcome.end.endswith(f":{fault_info(REBOOT).name}"):
            fault = fault_info(REBOOT)
            words = f"trial {recorded.outcome.number}: {fault.meaning}. {fault.remedy}"
            return self.end("stopped", f"{words} Then: {RESUME_COMMAND}")
        if end is None and by_hand:
            return self.end("interrupted", f"trial {recorded.outcome.number} was {BY_HAND}")
        return end

    def _prepare(self, around: TrialSetup) -> tuple[Ready | None, GuardedTrial]:
        """Up to a board that is armed, with what guards the trial; without preflight checks only
        the room is looked at."""
        fish, wanted, operator = around.fish, self.options.wanted, around.operator
        if self.chosen is None and not self.options.of_best:
            self._choose(self.law.begin(self.options.plan_anew))
        ready, book = None, library_of(fish)
        if wanted is None:
            travel_next(fish, book).require_room()
        else:
            wanted = replace(wanted, start_yaw_deg=self._start_yaw_deg(wanted))
            ready = prepare(fish, wanted, around.camera, operator)
            if ready.pose is not None and self.yaw_deg is None:
                self.yaw_deg = ready.pose.yaw_deg
        guarded = guarded_trial(fish, book, around.guard, operator.wants_abort)
        status = fish.status()
        volts = ready.battery_v if ready is not None else status.battery_v
        board_s = fish.clock.now_s()
        law = self.chosen.law if self.chosen is not None else ""
        self.log.begun(status.next_trial, status.iteration, ready, volts, board_s, law)
        if wanted is not None:
            self._count_down(wanted, status.next_trial)
        return ready, guarded

    def _count_down(self, wanted: PreflightLimits, number: int) -> None:
        try:
            countdown(self.around.fish, wanted, self.around.operator)
        except BaseException:
            with contextlib.suppress(InputError):  # what ended the countdown is what is told
                self.log.void(number, "not started")
            raise

    def _start_yaw_deg(self, wanted: PreflightLimits) -> float | None:
        """Of the first start of this call, else of the first one since the board was switched
        on."""
        if wanted.start_yaw_deg is not None or self.yaw_deg is not None:
            return self.yaw_deg if wanted.start_yaw_deg is None else wanted.start_yaw_deg
        fish = self.around.fish
        on_s = fish.clock.now_s()
        return self.log.first_yaw_deg(datetime.now().astimezone() - timedelta(seconds=on_s))

    def _swim(
        self, around: TrialSetup, ready: Ready | None, guarded: GuardedTrial
    ) -> tuple[RecordedTrial, bool] | SeriesEnd:
        """The trial, in the raw files; and whether the operator stopped it. An end when it was
        stopped before the board had begun a log."""
        fish, experiment = around.fish, self.log.experiment
        pose = ready.pose if ready else None
        heading_rad = pose.heading_rad if pose and pose.heading_rad is not None else 0.0
        swam = execute(around, experiment, guarded, heading_rad)
        number = swam.outcome.number
        stopped = BY_HAND if swam.outcome.interrupted else swam.stopped
        if swam.outcome.executed_beats == 0 and not self._has_log(number):
            self.log.void(number, swam.outcome.end)
            status = fish.status()
            if status.state in STOPPED and not dangerous(status.fault):
                fish.clear()
            words = f"trial {number} ended before its first beat ({stopped or swam.outcome.end})"
            return self.end("interrupted" if stopped == BY_HAND else "stopped", words)
        recorded = record_of(swam.outcome, keep_log(fish, experiment, number), ready, stopped)
        self.log.recorded(recorded)
        self.around.operator.tell(TrialRecorded(recorded, self.chosen))
        return recorded, stopped == BY_HAND

    def _settle(
        self, recorded: RecordedTrial, decision: Decision, made: InputChosen | None, counts: bool
    ) -> SeriesEnd | None:
        """Carries the decision out. An end when the board is left as it stopped."""
        done: DecisionResult = self.decisions.carry_out(recorded, decision)
        self.rounds.append(Round(recorded, decision, done.learned))
        self.counted += counts and decision.kind in self.options.counts
        if (learned := done.learned) is not None:
            self._choose(self.law.after(learned))
            operator, rolled_back = self.around.operator, learned.rolled_back
            self.verdict = assess_series(self.around.fish, operator, self.log, rolled_back)
            diagnosed = self.law.diagnose_last(made.law if made is not None else "")
            if diagnosed is not None:
                operator.tell(diagnosed)
                self.rounds[-1] = replace(self.rounds[-1], causes=diagnosed.causes)
            if not done.left and (found := self._accepted(self.rounds[-1].causes)) is not None:
                return replace(self.end("proposal", found.proposal), accepted=found)
        if not done.left:
            return None
        critical = self.around.fish.status().fault.number == BATTERY_CRITICAL
        then = RESUME_COMMAND if critical else "tailbeat board clear"
        return self.end("stopped", f"{done.left} Then: {then}")

    def _accepted(self, causes: Sequence[CauseFound]) -> CauseFound | None:
        """The first proposal, if the operator wants it carried out."""
        options = self.options
        if not (options.proposes and causes) or causes[0].cause in options.declined:
            return None
        found = causes[0]
        options.declined.add(found.cause)  # asked once, whatever the answer
        question = f"{found.text}. Proposal: {found.proposal}. Do it now?"
        return found if self.around.operator.confirm(question) else None

    def _choose(self, chosen: InputChosen) -> None:
        self.chosen = chosen
        self.around.operator.tell(chosen)

    def _notice(self, text: str) -> None:
        self.around.operator.tell(Notice(text))
