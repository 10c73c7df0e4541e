"""Swims one trial after the other: ritual, swim, keep, decide, learn, until there is enough."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from tailbeat.day.account import Account
from tailbeat.day.battery import forecast, too_low
from tailbeat.day.board import STOPPED, dangerous, make_safe, require_still, settled, stop_words
from tailbeat.day.deciding import Done, Office
from tailbeat.day.judging import judged, told
from tailbeat.day.logs import keep_log, outcome_of
from tailbeat.day.ritual import GivenUp, Wanted, countdown, prepare
from tailbeat.day.swimming import Around, swim
from tailbeat.day.swums import BY_HAND, swum_of
from tailbeat.day.until import Until
from tailbeat.errors import InputError, Refused
from tailbeat.experiment.board import copy_state
from tailbeat.experiment.current import require_same
from tailbeat.experiment.redo import write_redo
from tailbeat.faults import BATTERY_CRITICAL, BATTERY_LOW
from tailbeat.logbook import logbook_of
from tailbeat.travel import room_guard, travel_next

if TYPE_CHECKING:
    from tailbeat.camera.base import Camera
    from tailbeat.day.person import Decision, DecisionKind, Person
    from tailbeat.day.ritual import Ready
    from tailbeat.day.swum import Swum
    from tailbeat.experiment.folder import Experiment
    from tailbeat.fish import Fish, Guard
    from tailbeat.results import LearnReport
    from tailbeat.verdict import Verdict

__all__ = ["Options", "Round", "SeriesEnd", "Until", "swim_series"]


@dataclass(frozen=True)
class Options:
    """``wanted`` None: no ritual. ``learn``: kept swims are learned from at once; otherwise the
    series ends with the first, which waits. ``counts``: what a swim must have become to count for
    ``until.swims``."""

    until: Until = field(default_factory=Until)
    wanted: Wanted | None = field(default_factory=Wanted)
    learn: bool = True
    reconnect_s: float = 60.0
    counts: tuple[DecisionKind, ...] = ("keep",)


@dataclass(frozen=True)
class Round:
    """One swim and what became of it. ``learned`` None: nothing was learned."""

    swum: Swum
    decision: Decision
    learned: LearnReport | None


@dataclass(frozen=True)
class SeriesEnd:
    """``why``: ``swims``, ``converged``, ``battery``, ``interrupted`` (Ctrl-C or the person), or
    ``stopped`` (the board stopped by a rule of its own and is left so, with its reason)."""

    why: str
    words: str
    rounds: list[Round]
    verdict: Verdict | None

    @property
    def swums(self) -> list[Swum]:
        """The swims, in order."""
        return [one.swum for one in self.rounds]


def swim_series(
    fish: Fish,
    experiment: Experiment,
    person: Person,
    options: Options,
    camera: Camera | None = None,
    guard: Guard | None = None,
) -> SeriesEnd:
    """Swims until ``options.until``. The experiment must be of this fish and of the board's
    reference (``require_same``). Order of every round: a trial that still waits on the board is
    decided first; ritual; swim; its log pulled into the raw files; the decision, journalled; only
    then the board learns or discards; its state copied (``experiment.board``). So whatever fails on
    the way (disk full, link gone, Ctrl-C) the next call goes on where this one stopped and nothing
    is lost.

    A swim stopped by the person is decided on like any other; then the series ends. Raises what the
    ritual, the swim and the disk raise; the tail is still then."""
    require_same(fish, experiment)
    require_still(fish)
    around = Around(fish, person, camera, guard, options.reconnect_s)
    account = Account(experiment, experiment.journal)
    series = _Series(around, account, options, Office(fish, person, account, options.learn))
    try:
        return series.swim()
    except GivenUp as given_up:
        make_safe(fish)
        return series.end("interrupted", str(given_up))
    except KeyboardInterrupt:
        make_safe(fish)
        return series.end("interrupted", "stopped by Ctrl-C; what was swum waits on the board")
    except BaseException:
        make_safe(fish)
        raise


@dataclass
class _Series:
    """State of one call of swim_series."""

    around: Around
    account: Account
    options: Options
    office: Office
    rounds: list[Round] = field(default_factory=list)
    counted: int = 0
    verdict: Verdict | None = None
    yaw_deg: float | None = None  # of the first start, for the ritual to compare with

    def end(self, why: str, words: str) -> SeriesEnd:
        write_redo(self.account.experiment)
        return SeriesEnd(why, words, self.rounds, self.verdict)

    def swim(self) -> SeriesEnd:
        end = self._catch_up() or self._enough()
        while end is None:
            end = self._battery() or self._round() or self._enough()
        return end

    def _catch_up(self) -> SeriesEnd | None:
        """What an earlier call, or somebody else, has left: a trial that waits, a stopped board,
        something learned that was not written down."""
        fish, open_trial = self.around.fish, self.account.open_trial()
        if fish.status().state == "ARMED":
            fish.disarm()
        status = settled(fish, open_trial)
        begun = open_trial is not None and open_trial < status.next_trial
        number = status.pending_trial or (open_trial if begun else None)
        if status.pending_trial is None:
            self._write_down_owed(status.last_learned_trial)
        if number is not None and (number == status.pending_trial or self._has_log(number)):
            return self._finish_old(number)
        return self._cleared()

    def _finish_old(self, number: int) -> SeriesEnd | None:
        fish = self.around.fish
        self._notice(f"trial {number} waits on the board; it is decided on first")
        log = keep_log(fish, self.account.experiment, number)
        swum = swum_of(outcome_of(log.trial), log, None)
        self._take(swum)
        decision = self.office.decide(swum)
        status = fish.status()
        if dangerous(status.fault) and (end := self._cleared()) is not None:
            return end
        return self._settle(swum, decision, counts=False)

    def _cleared(self) -> SeriesEnd | None:
        """The board is not stopped, or the person lets it go on."""
        status = self.around.fish.status()
        if status.state not in STOPPED:
            return None
        words = stop_words(status)
        if not self.around.person.confirm(f"{words} Clear it and go on?"):
            return self.end("stopped", f"{words} Then: tailbeat clear")
        self.around.fish.clear()
        return None

    def _has_log(self, number: int) -> bool:
        return any(trial.number == number for trial in self.around.fish.trials())

    def _write_down_owed(self, last_learned: int | None) -> None:
        owed = self.account.owed()
        if owed is not None and owed == last_learned:
            report = self.around.fish.learn(owed)  # said again it only tells what it learned
            self.office.write_down(report)
            copy_state(self.around.fish, self.account.experiment)

    def _enough(self) -> SeriesEnd | None:
        """Whether the series has reached its end."""
        until, verdict = self.options.until, self.verdict
        if until.swims is not None and self.counted >= until.swims:
            return self.end("swims", _counted_words(self.counted))
        if until.converged and verdict is not None and verdict.stop:
            return self.end("converged", f"{verdict.stop_reason}: {verdict.advice}")
        pending = self.around.fish.status().pending_trial
        if pending is None:
            return None
        words = f"trial {pending} is kept and waits to be learned from: tailbeat learn"
        if self.counted == 0:
            raise InputError(
                words.rpartition(":")[0], "tailbeat learn, or go on without --no-learn"
            )
        return self.end("swims", words)

    def _battery(self) -> SeriesEnd | None:
        """Before each swim: whether the battery still allows it."""
        fish = self.around.fish
        now_v = fish.status().battery_v
        params = {name: fish.params.get(name).value for name in ("BATT_LOW_V", "BATT_CRIT_V")}
        if (words := too_low(now_v, params)) is not None:
            return self.end("battery", f"{words}; change it, then: tailbeat session resume")
        if (words := forecast(now_v, self.account.drains(), params)) is not None:
            self._notice(words)
        return None

    def _round(self) -> SeriesEnd | None:
        camera = self.around.camera
        own = self.around.fish.default_camera() if camera is None else None
        try:
            around = replace(self.around, camera=camera or own)
            swam = self._swim(around, *self._prepare(around))
        except Refused as refused:
            if refused.number != BATTERY_LOW:
                raise
            return self.end("battery", f"{refused}")
        finally:
            if own is not None:  # nobody looks at its pictures while the person decides
                own.close()
        if isinstance(swam, SeriesEnd):
            return swam
        swum, by_hand = swam
        decision = self.office.decide(swum)
        end = self._settle(swum, decision, counts=True)
        if end is None and by_hand:
            return self.end("interrupted", f"trial {swum.outcome.number} was {BY_HAND}")
        return end

    def _prepare(self, around: Around) -> tuple[Ready | None, Guard]:
        """Up to a board that is armed, with the guard that ends the swim by distance; without a
        ritual only the room is looked at."""
        fish, wanted, person = around.fish, self.options.wanted, around.person
        ready, book = None, logbook_of(fish)
        if wanted is None:
            travel_next(fish, book).require_room()
        else:
            wanted = replace(wanted, start_yaw_deg=self._start_yaw_deg(wanted))
            ready = prepare(fish, wanted, around.camera, person)
            if ready.pose is not None and self.yaw_deg is None:
                self.yaw_deg = ready.pose.yaw_deg
        room, status = room_guard(fish, book), fish.status()
        volts = ready.battery_v if ready is not None else status.battery_v
        self.account.begun(status.next_trial, status.iteration, ready, volts)
        if wanted is not None:
            countdown(fish, wanted, person)
        return ready, room

    def _start_yaw_deg(self, wanted: Wanted) -> float | None:
        return self.yaw_deg if wanted.start_yaw_deg is None else wanted.start_yaw_deg

    def _swim(
        self, around: Around, ready: Ready | None, room: Guard
    ) -> tuple[Swum, bool] | SeriesEnd:
        """The swim, in the raw files; and whether the person stopped it. An end when it was stopped
        before the board had begun a log."""
        fish, experiment = around.fish, self.account.experiment
        pose = ready.pose if ready else None
        heading_rad = pose.heading_rad if pose and pose.heading_rad is not None else 0.0
        swam = swim(around, experiment, room, heading_rad)
        number = swam.outcome.number
        stopped = BY_HAND if swam.outcome.interrupted else swam.stopped
        if swam.outcome.executed_beats == 0 and not self._has_log(number):
            self.account.void(number, swam.outcome.end)
            words = f"trial {number} ended before its first beat ({stopped or swam.outcome.end})"
            return self.end("interrupted" if stopped == BY_HAND else "stopped", words)
        log = keep_log(fish, experiment, number)
        swum = swum_of(swam.outcome, log, ready, stopped)
        self._take(swum)
        return swum, stopped == BY_HAND

    def _take(self, swum: Swum) -> None:
        self.account.swum(swum)
        event = {"event": "swum", "trial": swum.outcome.number, **vars(swum)}
        self.around.person.tell(event)

    def _settle(self, swum: Swum, decision: Decision, counts: bool) -> SeriesEnd | None:
        """Carries the decision out. An end when the board is left as it stopped."""
        done: Done = self.office.carry_out(swum, decision)
        self.rounds.append(Round(swum, decision, done.learned))
        self.counted += counts and decision.kind in self.options.counts
        if done.learned is not None:
            self.verdict = judged(self.account, self.around, done.learned.rolled_back)
            told(self.around.person, self.verdict)
        if not done.left:
            return None
        critical = self.around.fish.status().fault.number == BATTERY_CRITICAL
        then = "session resume" if critical else "clear"
        return self.end("stopped", f"{done.left} Then: tailbeat {then}")

    def _notice(self, text: str) -> None:
        self.around.person.tell({"event": "notice", "text": text})


def _counted_words(count: int) -> str:
    return f"{count} swim{'' if count == 1 else 's'}"
