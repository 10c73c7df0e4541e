"""What an experiment's event log says of a session: trials that were started, recorded, decided on;
how the battery fell, and whether the board was switched off.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from tailbeat.board.fish import Fish
from tailbeat.board.snapshot import Snapshot, make_folder
from tailbeat.core import decode
from tailbeat.core.errors import InputError
from tailbeat.core.files import plain, write_whole
from tailbeat.core.printable import Hex
from tailbeat.core.trial_file import Trial, read_trial
from tailbeat.experiment.current import reference_crc
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.store import Journal, Kept, read_kept
from tailbeat.session.events import InputChosen, TrialDiagnosed
from tailbeat.session.outcome import KINDS, Decision, Ready, RecordedTrial

_LOOK_BACK = 3  # swims the fall is averaged over: one reading scatters by some 20 mV


@dataclass(frozen=True)
class Drain:
    """One trial's voltages: ``start_v`` at rest before it, ``end_v`` at its end, ``least_v`` the
    least while the servo drew its current."""

    start_v: float
    end_v: float
    least_v: float


def too_low(now_v: float, params: Mapping[str, float]) -> str | None:
    """Why the board would refuse to arm, or None."""
    limit_v = params.get("BATT_LOW_V", 0.0)
    if limit_v <= 0 or now_v >= limit_v:
        return None
    return f"the battery has {now_v:.2f} V, and below {limit_v:.2f} V the board does not arm"


def forecast(now_v: float, drains: Sequence[Drain], params: Mapping[str, float]) -> str | None:
    """What will go wrong in the next trial or the one after it, or None. ``drains``: of the trials
    on this battery, oldest first."""
    recent = drains[-_LOOK_BACK:]
    if not recent:
        return None
    sag_v = max(drain.start_v - drain.least_v for drain in recent)
    critical_v = params.get("BATT_CRIT_V", 0.0)
    if critical_v > 0 and now_v - sag_v < critical_v:
        return (
            f"the battery will not last: it has {now_v:.2f} V and a trial takes it {sag_v:.2f} V"
            f" down. Below {critical_v:.2f} V the tail stops. Change it before this trial"
        )
    starts = [*(drain.start_v for drain in recent), now_v]
    fall_v = (starts[0] - starts[-1]) / len(recent)
    low_v = params.get("BATT_LOW_V", 0.0)
    if low_v > 0 and fall_v > 0 and now_v - fall_v < low_v:
        return (
            f"the battery has {now_v:.2f} V and falls by {fall_v:.2f} V per trial. Below"
            f" {low_v:.2f} V the board will not arm after this one; have a charged one ready"
        )
    return None


_KNOWN = ("begun", "resumed", "restarted")
_CLOCKS_S = 30.0  # the laptop's clock may be set meanwhile; nobody swaps a battery in less
_CLOCKS_PART = 1e-3  # far beyond what two clocks run apart


def switched_off_since(fish: Fish, journal: Journal) -> int | None:
    """The trial since which the board was switched off and on without 'session resume'; None = it
    was not, or nobody can tell.

    By the board's clock, which counts from 0. Of a simulated board, whose clock has its own pace,
    only one that has gone back is told."""
    entries = [one for one in journal.entries() if one["what"] in _KNOWN]
    trial = next((one["trial"] for one in reversed(entries) if one["what"] == "begun"), None)
    last = entries[-1] if entries else {}
    if trial is None or last.get("board_s") is None:
        return None
    now_s = fish.status().time_s  # the clock of an open link takes a while to follow a restart
    if now_s < last["board_s"]:
        return int(trial)
    return int(trial) if not fish.info().simulated and _was_off(last, now_s) else None


def _was_off(last: dict[str, Any], now_s: float) -> bool:
    """Whether the board counts less time since then than the computer."""
    passed = datetime.now().astimezone() - datetime.fromisoformat(last["time"])
    passed_s = passed.total_seconds()
    counted_s = now_s - float(last["board_s"])
    return passed_s - counted_s > _CLOCKS_S + _CLOCKS_PART * abs(passed_s)


def accepted(fish: Fish, journal: Journal) -> None:
    """Somebody knows of it, and the day goes on."""
    journal.add("restarted", board_s=fish.clock.now_s())


Entry = dict[str, Any]
_CLOCKS_AGREE_S = 1.0


@dataclass(frozen=True)
class SessionLog:
    """Trials are known by their raw files: a board whose storage was made anew counts from 1
    again, and a number alone would mistake one trial's decision for another's."""

    experiment: Experiment

    @property
    def journal(self) -> Journal:
        """The event log of the experiment."""
        return self.experiment.journal

    def begun(
        self,
        trial: int,
        iteration: int,
        ready: Ready | None,
        battery_v: float,
        board_s: float,
        law: str = "",
    ) -> None:
        """Before the countdown: whatever happens from now on, this trial is asked for. ``board_s``:
        now, by the board's clock; the entry's ``utc_s`` is the same moment by this computer's.
        ``law``: of its input, as of ``InputChosen``."""
        self.journal.add(
            "begun",
            trial=trial,
            iteration=max(1, iteration),  # a board that was never armed counts from 0
            **_found(ready),
            battery_start_v=battery_v,
            board_s=board_s,
            utc_s=round(time.time(), 3),
            law=law,
        )

    def chosen(self, chosen: InputChosen, trial: int) -> None:
        """What makes the input of ``trial``, which comes next."""
        self.journal.add("input", trial=trial, **asdict(chosen))

    def chosen_for(self, trial: int) -> InputChosen | None:
        """What makes the input of a trial; None: it is not known."""
        entries = reversed(self.journal.entries("input"))
        found = next((entry for entry in entries if entry["trial"] == trial), None)
        if found is None:
            return None
        expected = found.get("expected_m_s")
        return InputChosen(found["law"], found["why"], expected and tuple(expected))

    def diagnosed(self, found: TrialDiagnosed) -> None:
        """What explains a trial's error."""
        self.journal.add(
            "diagnosis", trial=found.trial, causes=[asdict(one) for one in found.causes]
        )

    def is_begun(self, trial: Trial) -> bool:
        """Whether a log is of the trial that was begun last: by its number, its reference, and that
        it started later."""
        last = self._last(("begun", "swum", "void"))
        crc = reference_crc(self.experiment)
        if (
            last is None
            or last.get("trial") != trial.number
            or crc not in (None, trial.reference_crc)
        ):
            return False
        begun_s = last.get("board_s") if last["what"] == "begun" else None
        return begun_s is None or trial.start_us * 1e-6 >= begun_s - _CLOCKS_AGREE_S

    def first_yaw_deg(self, since: datetime) -> float | None:
        """Of the IMU at the first start after ``since`` and after the battery was last changed:
        the IMU counts its yaw anew when it is switched on."""
        found = None
        for entry in self.journal.entries():
            if entry["what"] == "resumed":
                found = None
            pose = entry.get("pose") if entry["what"] == "begun" else None
            if found is None and pose and datetime.fromisoformat(entry["time"]) >= since:
                found = pose.get("yaw_deg")
        return found

    def open_trial(self) -> int | None:
        """A trial that was begun and is not known to have been executed, or on which nobody
        decided."""
        last = self._last(("begun", "swum", "void", "decided", "withdrawn", "learned"))
        is_open = last is not None and last["what"] in ("begun", "swum", "withdrawn")
        return int(last["trial"]) if is_open and last is not None else None

    def last_executed(self) -> int | None:
        """The number of the trial that was recorded last."""
        last = self._last(("swum",))
        return None if last is None else int(last["trial"])

    def void(self, trial: int, end: str) -> None:
        """Given up, or ended before its first beat; the board has no log of it."""
        self.journal.add("void", trial=trial, end=end)

    def recorded(self, recorded: RecordedTrial) -> None:
        """Once its log is in the raw files; a second time does nothing."""
        number, file = recorded.outcome.number, recorded.file.name
        stopped = recorded.stopped
        if any(entry.get("file") == file for entry in self.journal.entries("swum")):
            return
        begun = self._last(("begun", "swum"))
        found = _found(recorded.ready)
        if (
            recorded.ready is None
            and begun
            and begun["what"] == "begun"
            and begun["trial"] == number
        ):
            found = {key: begun.get(key) for key in found}
        self.journal.add(
            "swum",
            trial=number,
            iteration=recorded.outcome.iteration,
            end=recorded.outcome.end,
            file=file,
            **found,
            battery_start_v=recorded.battery_start_v,
            battery_end_v=recorded.battery_end_v,
            straight=None if recorded.straight is None else asdict(recorded.straight),
            problems=list(recorded.problems),
            stopped=stopped and {"kind": stopped.kind.value, "text": stopped.text},
        )

    def decided(self, recorded: RecordedTrial, decision: Decision) -> None:
        """Before the board hears of it."""
        self.journal.add(
            "decided",
            trial=recorded.outcome.number,
            decision=decision.kind,
            reason=decision.reason,
            file=recorded.file.name,
        )

    def withdrawn(self, recorded: RecordedTrial, why: str) -> None:
        """The board refused what was decided: it is asked again."""
        self.journal.add(
            "withdrawn", trial=recorded.outcome.number, file=recorded.file.name, reason=why
        )

    def decision_on(self, file: Path) -> Decision | None:
        """What was decided on a trial."""
        return self._decisions().get(file.name)

    def _decisions(self) -> dict[str, Decision]:
        """The last on every file, by its name."""
        found: dict[str, Decision] = {}
        for entry in self.journal.entries():
            name = str(entry.get("file"))
            if entry["what"] == "withdrawn":
                found.pop(name, None)
            elif entry["what"] == "decided" and entry["decision"] in KINDS:
                found[name] = Decision(entry["decision"], entry.get("reason") or "")
        return found

    def owed(self) -> int | None:
        """A trial decided to be learned from, of which nothing is known since: the board may have
        learned, but what it said was not written down."""
        last = self._last(("decided", "withdrawn", "learned", "begun"))
        owes = last is not None and last["what"] == "decided" and last["decision"] == "keep"
        return int(last["trial"]) if owes and last is not None else None

    def to_repeat(self) -> Trial | None:
        """The trial whose input is to be executed again, as it was decided; None: learned from
        since. Raises InputError."""
        last = self._last(("decided", "withdrawn", "learned"))
        if last is None or last["what"] != "decided" or last["decision"] == "keep":
            return None
        path = self.experiment.raw / str(last.get("file"))
        return read_trial(path) if path.is_file() else None

    def executed(self) -> tuple[list[Kept], list[str]]:
        """The trials in the order they were executed, each by its longest file, and what is wrong
        with files that cannot be read."""
        names = dict.fromkeys(str(entry.get("file")) for entry in self.journal.entries("swum"))
        paths = (self.experiment.raw / name for name in names)
        return read_kept(path for path in paths if path.is_file())

    def counting(self) -> list[Trial]:
        """Trials in the order they were executed, without the discarded. Raises InputError."""
        kept, problems = self.executed()
        decisions = self._decisions()
        for problem in problems:
            if any(made.kind != "discard" and name in problem for name, made in decisions.items()):
                raise InputError(problem)
        last = [[decisions[name] for name in one.names if name in decisions] for one in kept]
        return [
            one.trial
            for one, made in zip(kept, last, strict=True)
            if made and made[-1].kind != "discard"
        ]

    def drains(self) -> list[Drain]:
        """Of the trials since the battery was last changed."""
        kept = self.executed()[0]
        trials = {one.names[0]: one.trial for one in kept}
        longer = {name for one in kept for name in one.names[1:]}
        drains: list[Drain] = []
        for entry in self.journal.entries():
            if entry["what"] == "resumed":
                drains = []
            elif entry["what"] == "swum" and (name := str(entry.get("file"))) not in longer:
                drains += _drain(entry, trials.get(name))
        return drains

    def _last(self, kinds: tuple[str, ...]) -> Entry | None:
        entries = reversed(self.journal.entries())
        return next((entry for entry in entries if entry["what"] in kinds), None)


def _drain(entry: Mapping[str, Any], trial: Trial | None) -> list[Drain]:
    """One, or none where the voltages are unknown. ``trial``: None = its file cannot be read."""
    start_v, end_v = entry.get("battery_start_v"), entry.get("battery_end_v")
    if start_v is None or end_v is None:
        return []
    volts = () if trial is None else trial.battery_v
    least_v = min((volt for t_s, volt in volts if t_s >= 0), default=end_v)
    return [Drain(start_v, end_v, min(least_v, end_v))]


def _found(ready: Ready | None) -> Entry:
    """What the preflight checks found, as the event log keeps it."""
    found = None if ready is None else asdict(ready)
    return {key: found and found[key] for key in ("rested_s", "pose", "drift", "travel")}


RESUME_COMMAND = "tailbeat session resume"


class RepeatFile(decode.StrictTable):
    """``board/repeat.json``: what is to swim next once the repeat is executed, and the repeat's
    number; there from before the board's amplitudes change until they are back."""

    learned: Hex
    trial: int


def repeat_path(experiment: Experiment) -> Path:
    """Where it lies."""
    return experiment.folder / "board" / "repeat.json"


def held_before(experiment: Experiment) -> Snapshot | None:
    """What the board held before the repeat; ``next_trial`` is the repeat's number. None: no repeat
    is under way, or its file is torn (it is written in one step)."""
    try:
        held = decode.read(repeat_path(experiment), RepeatFile, RESUME_COMMAND)
    except InputError:
        return None
    return Snapshot("", {}, next_trial=held.trial, learned=held.learned)


def write_held(experiment: Experiment, held: Snapshot) -> None:
    """Raises InputError."""
    path = repeat_path(experiment)
    make_folder(path.parent)
    write_whole(path, json.dumps(plain({"learned": held.learned, "trial": held.next_trial})) + "\n")
