"""An experiment once more: ``redo.md`` says how to do it again, and ``relearn`` learns from its
trials again, with the board's own code, one after the other.
"""

from __future__ import annotations

import contextlib
import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.board.snapshot import Snapshot
from tailbeat.core.arrays import F32
from tailbeat.core.errors import InputError
from tailbeat.core.files import MAKE_ROOM, write_whole
from tailbeat.core.law import Averaging, Law, errors_of
from tailbeat.core.law_memory import LawMemory
from tailbeat.core.native import ffi, lib
from tailbeat.core.records import decode_learned
from tailbeat.core.trial_file import Trial
from tailbeat.experiment.analysis import Analysis
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.trial_rows import TrialRow
from tailbeat.sim.config import PLANTS, config_values, make_config

REDO = "redo.md"
_UNRECORDED = (
    "Commands of the live page, of scripts and of older tools were not recorded. Their options"
    " (`--rest`, `--until`, `--camera`) are unknown. Their results are listed with each trial and"
    " in `journal.jsonl`."
)
_UNKNOWN_SIMULATOR = ("simulated plant", "seed")  # its fault-injection port did not answer
_ABOUT = {
    "fish": "fish",
    "configuration": "configuration",
    "operator": "operator",
    "board": "board",
    "unique_id": "unique id",
    "firmware": "firmware",
    "reference": "reference",
    "law": "law",
    "plant": "simulated plant",
    "seed": "seed",
}


def write_redo(experiment: Experiment) -> Path:
    """``redo.md``: one page that says how to do the experiment again: the commands in order with
    what was set, the conditions, versions, and the command that replays it. From journal and
    settings alone."""
    path = experiment.folder / REDO
    write_whole(path, redo_text(experiment), MAKE_ROOM)
    return path


def redo_text(experiment: Experiment) -> str:
    """The page, Markdown."""
    settings, entries = experiment.settings(), experiment.journal.entries()
    unknown = [] if any(one["what"] == "typed" for one in entries) else [_UNRECORDED]
    parts = [
        f"# {experiment.stable_name}, done again",
        "## What it was\n\n" + "\n".join(_about(settings)),
        "## Before the first trial\n\n" + _code(_before(settings)),
        "## What was done, in order\n\n" + "\n".join(_steps(entries)),
        *unknown,
        "## The same numbers and figures from the raw files\n\n"
        + _code(["(cd raw && sha256sum -c SHA256SUMS)", "tailbeat experiment replay ."]),
    ]
    return "\n\n".join(parts) + "\n"


def _about(settings: Mapping[str, Any]) -> Iterator[str]:
    if settings.get("simulated"):
        yield "- **simulated**: no real fish"
    for key, words in _ABOUT.items():
        if settings.get(key) not in (None, ""):
            yield f"- {words}: {settings[key]}"
    if settings.get("simulated") and not settings.get("plant"):
        yield from (f"- {words}: unknown" for words in _UNKNOWN_SIMULATOR)
    tool = settings.get("tool", {})
    yield "- tool: " + ", ".join(f"{name} {version}" for name, version in tool.items())
    for key, value in (settings.get("conditions") or {}).items():
        yield f"- {key}: {value}"


def _before(settings: Mapping[str, Any]) -> Iterator[str]:
    """Parameters that are not what a new board has, the reference, a new folder beside this one."""
    yield "# in this folder"
    if settings.get("plant"):
        yield f"# in another terminal: {shlex.join(_simulator(settings))}"
    elif settings.get("simulated"):
        yield "# in another terminal: tailbeat sim, with the plant and the seed of then (unknown)"
    yield "tailbeat params reset"
    for name, value in _changed(settings.get("params", {})).items():
        yield f"tailbeat params set {name} {_number(value)}"
    yield "tailbeat reference upload reference.csv"
    yield shlex.join(_new(settings))


def _simulator(settings: Mapping[str, Any]) -> list[str]:
    """The command that makes the fish: one in the tool itself is new in every command."""

    plant, seed = str(settings["plant"]), settings.get("seed", 1)
    words = ["tailbeat", "sim", "--plant", plant, "--seed", str(seed)]
    usual = config_values(make_config(plant, seed, {})) if plant in PLANTS else {}
    for name, value in (settings.get("simulator") or {}).items():
        if name not in ("plant", "seed") and usual.get(name) != value:
            words += ["--set", f"{name}={value!r}"]
    return words


def _new(settings: Mapping[str, Any]) -> list[str]:
    """The command that makes the folder."""
    words = ["tailbeat", "experiment", "new", "--root", "..", "--reference", "reference.csv"]
    for key in ("fish", "configuration", "operator"):
        if settings.get(key):
            words += [f"--{key}", str(settings[key])]
    for key, value in (settings.get("conditions") or {}).items():
        words += ["--condition", f"{key}={value}"]
    return words


def _changed(params: Mapping[str, float]) -> dict[str, float]:
    fresh = ffi.new("params_t *")
    lib.params_reset(fresh)
    found = {}
    for name, value in params.items():
        param = lib.param_find(name.encode().ljust(lib.NATIVE_PARAM_NAME_BYTES, b"\0"))
        if param >= lib.PARAM_COUNT or fresh.value[param] != value:
            found[name] = value
    return found


def _steps(entries: list[dict[str, Any]]) -> Iterator[str]:
    number = 0
    for entry in entries:
        if line := _step(entry):
            number += 1
            yield f"{number}. {entry['time']}: {line}"
    if number == 0:
        yield "The event log is empty: an older tool made this folder. The trials are in `raw/`."


def _step(entry: Mapping[str, Any]) -> str:
    """One line; nothing for what is only of use to the tool."""
    what, trial = entry["what"], entry.get("trial")
    if what == "set":
        params = {key: _number(value) for key, value in (entry.get("params") or {}).items()}
        values = {**params, **(entry.get("conditions") or {})}
        values |= {k: entry[k] for k in ("operator", "configuration") if entry.get(k)}
        return "set " + ", ".join(f"{key} = {value}" for key, value in values.items())
    if what == "swum":
        end = entry.get("end", "")
        iteration = entry.get("iteration")
        return f"trial {trial} executed, iteration {iteration}, {end}{_found(entry)}"
    if what == "decided":
        reason = f" ({entry['reason']})" if entry.get("reason") else ""
        return f"trial {trial}: {entry.get('decision')}{reason}"
    if what == "withdrawn":
        return f"trial {trial}: decision withdrawn ({entry.get('reason')})"
    if what == "learned":
        back = "; rolled back to the best" if entry.get("rolled_back") else ""
        return f"learned from trial {trial}{back}"
    if what == "note":
        return f"note: {' '.join(str(entry.get('text', '')).split())}"
    return {
        "made": "`tailbeat experiment new`",
        "opened": "gone on with",
        "typed": f"`{entry.get('command')}`",
        "resumed": "after a battery swap the board was given back what it lacked",
        "restarted": "the board had been switched off; gone on with, without a repeat of the best",
        "trimmed": f"`tailbeat session trim`: centre {entry.get('centre_us')} us",
        "identified": f"`tailbeat session identify`: {entry.get('file')}",
        "restored": "`tailbeat trial learn --restore-best`: the best input is next"
        + (f" (trial {trial})" if trial else ""),
    }.get(what, "")


def _found(entry: Mapping[str, Any]) -> str:
    """What the preflight checks found, as far as it was journalled."""
    rested_s, pose = entry.get("rested_s"), entry.get("pose") or {}
    rested = "" if rested_s is None else f", rested {rested_s:.0f} s"
    return rested + (f", pose by {pose['source']}" if pose.get("source") else "")


def _number(value: float) -> str:
    """The fewest digits that give the board's single precision number again."""
    return np.format_float_positional(np.float32(value), trim="-")


def _code(lines: list[str] | Iterator[str]) -> str:
    return "```\n" + "\n".join(lines) + "\n```"


_BY_THE_BOARD = ("law", "restored", "first", "")  # what makes a trial's amplitudes; "" = not told
_NOT_HERE = "what the board had learned before is not in the folder"


@dataclass
class Relearned:
    """``learned``: trials after which the law gives the very amplitudes of the next.
    ``not_learned``: trials that were learned from, of which that cannot be told, and why."""

    learned: list[int] = field(default_factory=list)
    not_learned: list[tuple[int, str]] = field(default_factory=list)
    different: list[str] = field(default_factory=list)


def relearn(analysis: Analysis, held: Snapshot | None = None) -> Relearned:
    """Every trial that was learned from, against the amplitudes of the next; the last one against
    ``held``, the board's state as it was copied last. Older firmware judged no trial with missing
    beats: what does not come out by today's rule may by that one."""
    found = _relearned(analysis, held, judges_gaps=True)
    if not found.different:
        return found
    older = _relearned(analysis, held, judges_gaps=False)
    return older if len(older.different) < len(found.different) else found


def _relearned(analysis: Analysis, held: Snapshot | None, judges_gaps: bool) -> Relearned:
    found = Relearned()
    reference_m_s = analysis.reference_m_s.astype(np.float32)
    memory = LawMemory(len(reference_m_s))
    board = _Board(reference_m_s, analysis.beat_s, judges_gaps, memory)
    pending: tuple[TrialRow, Trial] | None = None
    aside: _Board | None = None
    for row, trial in zip(analysis.rows, analysis.trials, strict=True):
        if trial.input in _BY_THE_BOARD:
            before = board.copy()
            if aside is not None and aside.same(trial.beats.amplitude_rad):
                board = aside
            board = _expected(board, pending, trial, found)
            aside = before if _only_repeats(row, trial, pending) else None
            pending = None
        elif pending is not None:
            found.not_learned.append((pending[1].number, "the next amplitudes were uploaded"))
            board, pending = next(board.after(pending[1], trial)), None
        if row.learned:
            if trial.input not in _BY_THE_BOARD:
                board.take_over(trial)
            pending = row, trial
    if pending is not None:
        _against_state(board, pending[1], held, found)
    return found


def _only_repeats(row: TrialRow, trial: Trial, pending: tuple[TrialRow, Trial] | None) -> bool:
    """Whether the best swam once more for its own sake, as after a battery swap: then what was to
    swim before may be put back."""
    return pending is None and trial.input == "restored" and row.decision == "repeat"


def _expected(
    board: _Board, pending: tuple[TrialRow, Trial] | None, trial: Trial, found: Relearned
) -> _Board:
    """The board as it was when ``trial`` swam; what it swam is compared."""
    if board.begins(trial):
        if pending is not None:
            found.not_learned.append((pending[1].number, "the board began anew after it"))
        pending = None
        board.first(trial)
    if pending is None:
        if trial.input == "restored" and board.whole:
            board.restore_best()
        if not board.same(trial.beats.amplitude_rad):
            if board.whole:
                found.different.append(
                    f"trial {trial.number} executed another input than the expected one"
                )
            board.take_over(trial)
        return board
    number, rolled_back = pending[1].number, pending[0].rolled_back
    last: _Board | None = None
    for candidate in board.after(pending[1], trial):
        last = candidate
        if candidate.same(trial.beats.amplitude_rad) and candidate.rolled_back == rolled_back:
            found.learned.append(number)
            return candidate
    assert last is not None
    if last.refusal:
        found.not_learned.append((number, last.refusal))
    elif not board.whole:
        found.not_learned.append((number, _NOT_HERE))
    else:
        found.different.append(
            f"trial {trial.number} did not swim what the law makes of trial {number}"
        )
    last.take_over(trial)
    return last


def _against_state(board: _Board, trial: Trial, held: Snapshot | None, found: Relearned) -> None:
    """Of the last trial: what the board had learned when its state was copied."""
    why = "no trial was executed after it"
    if held is not None and held.learned is not None and held.last_learned_trial == trial.number:
        record = decode_learned(held.learned)
        back = record.input == lib.MEMORY_INPUT_RESTORED
        following = replace(trial, input="restored") if back else trial
        candidates = list(board.after(trial, following))
        if record.input not in (lib.MEMORY_INPUT_LAW, lib.MEMORY_INPUT_RESTORED):
            why = "the next amplitudes were uploaded"
        elif any(one.same(record.amplitude_rad) for one in candidates):
            found.learned.append(trial.number)
            return
        elif candidates[-1].refusal or not board.whole:
            why = candidates[-1].refusal or _NOT_HERE
        else:
            found.different.append(
                f"board/state.json does not hold what the law makes of trial {trial.number}"
            )
            return
    found.not_learned.append((trial.number, why))


@dataclass
class _Board:
    """A board's memory and the trials it looks back on. ``whole``: all of it is known since the
    first trial."""

    reference_m_s: F32
    beat_s: float
    judges_gaps: bool
    memory: LawMemory
    begun: bool = False
    whole: bool = False
    past_doubted: bool = False
    rolled_back: bool = False
    refusal: str = ""

    def copy(self) -> _Board:
        return replace(self, memory=self.memory.copy(), rolled_back=False, refusal="")

    def begins(self, trial: Trial) -> bool:
        """Whether the board had learned nothing when ``trial`` swam."""
        return trial.iteration == 1 and trial.input in ("first", "")

    def first(self, trial: Trial) -> None:
        """The law applied to rest."""
        self.begun, self.past_doubted = True, False
        with contextlib.suppress(InputError):
            self.whole = False
            self.memory.first(Law.from_params(trial.params, self.beat_s), self.reference_m_s)
            self.whole = True

    def take_over(self, trial: Trial) -> None:
        """The amplitudes of a trial that the board got in another way; they have no past."""
        recorded = trial.beats.amplitude_rad
        known = np.isfinite(recorded)
        held = np.where(known, recorded, self.memory.amplitude_rad)
        self.memory.set_input(held, trial.iteration)
        self.begun = True
        self.whole = self.whole and bool(known.all())
        self.past_doubted = True

    def restore_best(self) -> None:
        """As asked for by the host; what it looks back on is the firmware's to say."""
        self.memory.restore_best()
        self.past_doubted = True

    def same(self, amplitude_rad: F32) -> bool:
        """Bit for bit, where the file tells (a trial that was cut short tells of its beats)."""
        if not self.begun or len(amplitude_rad) != self.memory.beats:
            return False
        known = np.isfinite(amplitude_rad)
        mine = self.memory.amplitude_rad
        return mine[known].tobytes() == amplitude_rad[known].tobytes()

    def after(self, trial: Trial, following: Trial) -> Iterator[_Board]:
        """The board when it has learned from ``trial``, the likeliest first: parameters may have
        been set before or after learning, amplitudes that were brought back may have a past."""
        settings: list[Mapping[str, float]] = [trial.params]
        if following.params != trial.params:
            settings.append(following.params)
        for params in settings:
            for forget in (False, True) if self.past_doubted else (False,):
                board = self.copy()
                board._learn(trial, params, forget)
                yield board
                if following.input == "restored" and not board.rolled_back:
                    restored = board.copy()
                    restored.restore_best()
                    yield restored

    def _learn(self, trial: Trial, params: Mapping[str, float], forget: bool) -> None:
        if forget:
            self.memory.forget()
        error, measured = errors_of(self.reference_m_s, trial.beats.speed_m_s)
        if not measured.any():
            self.refusal = "its file has no speeds: they were uploaded after it was pulled"
            return
        complete = trial.end_fault == 0 and trial.executed_beats == self.memory.beats
        complete = complete and (self.judges_gaps or bool(measured.all()))
        law = Law.from_params(params, self.beat_s)
        rollback_ratio = params.get("ROLLBACK_RATIO", 0.0)
        extrapolation = int(params.get("ILC_EXTRAP", 0))
        try:
            self.memory.average(Averaging.from_params(params))
            self.memory.learn(law, error, measured, complete, rollback_ratio, extrapolation)
        except InputError:
            self.refusal = "the law refuses it"
            return
        self.rolled_back = self.memory.rolled_back
