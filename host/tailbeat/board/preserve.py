"""Runs with other inputs than those the board learns: an identification, a trim.

Whatever the board had learned, its reference, and the parameters that are changed meanwhile are
restored afterwards, also after Ctrl-C or an error; until then a copy lies on the disk. A procedure
that was interrupted (a laptop that died) leaves the copy behind; the next one restores it first,
and so does 'session resume'. Beside the copy's records lies ``references.txt``, the CRC of every
reference that the runs gave the board: by it an interrupted procedure is recognized.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import ArrayLike

from tailbeat.board.fish import REST_CRC, Fish, rest
from tailbeat.board.snapshot import BOARD_FILE, Snapshot
from tailbeat.core import law
from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError, TailbeatError
from tailbeat.core.law_memory import first_amplitudes
from tailbeat.core.platform.files import sync_folder
from tailbeat.core.records import decode_reference, record_crc
from tailbeat.core.reference import Reference
from tailbeat.core.trial_file import Trial, read_trial
from tailbeat.link.messages import BoardStatus, TrialOutcome

RESTORE_COMMAND = "tailbeat session resume"

_REFERENCES = "references.txt"
_ASIDE_MAX = 999
_RESTORE_TRIES = 3
_STOP_LOOKS, _STOP_LOOK_S = 60, 0.5  # of board time; settling takes no longer


@dataclass(frozen=True)
class PreservedBoard:
    """A board during the runs. ``held``: what is restored; ``params``: all it had at the begin."""

    fish: Fish
    held: Snapshot
    params: dict[str, float]
    copy: Path | None

    def prepare(
        self,
        name: str,
        amplitude_rad: F64,
        speed_m_s: ArrayLike,
        changes: Mapping[str, float] | None = None,
    ) -> None:
        """Uploads the input of the next run. The reference is ``speed_m_s``, what the model
        predicts, so that the trial's error is the model's. ``changes``: parameters, set only once
        the reference tells that a procedure is under way."""
        speed = np.clip(speed_m_s, 0.0, self.params["REF_MAX_M_S"]).astype(np.float32)
        limit = np.float32(self.params["AMP_MAX_RAD"])
        record = Reference(1.0, speed, name).record()
        if self.copy is not None:
            _note_reference(self.copy, record_crc(record))
        self.fish.upload_reference(record)
        _set_params(self.fish, changes or {})
        self.fish.upload_amplitudes(np.minimum(amplitude_rad.astype(np.float32), limit))

    def collect(
        self,
        outcome: TrialOutcome,
        judge: Callable[[TrialOutcome], None],
        keep: Callable[[Path], object],
    ) -> Trial:
        """The run that has just ended: it is kept, and dropped on the board. ``judge`` may raise
        for how it ended, or act on the pending trial. Raises KeyboardInterrupt after Ctrl-C."""
        fish = self.fish
        if outcome.interrupted:
            raise KeyboardInterrupt
        judge(outcome)
        with TemporaryDirectory() as folder:
            path = fish.pull_trial(outcome.number, Path(folder))
            keep(path)
            trial = read_trial(path)
        fish.discard(outcome.number)
        return trial


@contextmanager
def preserved(
    fish: Fish,
    copy: Path | None,
    note: Callable[[str], None],
    what: str,
    changes: Sequence[str] = (),
) -> Iterator[PreservedBoard]:
    """``copy``: folder for the copy; one that is there already is restored when a procedure was
    interrupted, and never overwritten. ``what``: the command that this is for. ``changes``:
    parameters that will be set meanwhile. ``note``: told what a person should know. Raises
    InputError when the board cannot begin."""
    restore_interrupted(fish, copy, note)
    require_idle(fish, what)
    params = fish.params.values()
    held = _held(fish, params, changes)
    if copy is not None:
        _write_copy(copy, held, note)
    try:
        yield PreservedBoard(fish, held, params, copy)
    finally:
        _put_back(fish, held, copy)


def was_interrupted(fish: Fish, copy: Path | None) -> bool:
    """Whether the board still has a run's reference and amplitudes: no trial may begin."""
    return copy is not None and _left(fish, copy) is not None


def restore_interrupted(fish: Fish, copy: Path | None, note: Callable[[str], None]) -> bool:
    """Gives the board what it held before a procedure that was interrupted; whether there was one.
    A run that waits to be decided on is dropped. Raises InputError while the tail beats."""
    left = None if copy is None else _left(fish, copy)
    if copy is None or left is None:
        return False
    status = fish.status()
    if status.state == "RUNNING":
        raise InputError(
            "the board executes a trial of an identification or a trim.",
            f"If nobody waits for it: tailbeat stop, then {RESTORE_COMMAND}",
        )
    stopped = f" (it was stopped: {status.fault.name})" if status.fault.number else ""
    note(
        f"an identification or a trim was interrupted{stopped}. The board gets back what it held "
        f"before, from the copy in {copy}"
    )
    _put_back(fish, left, copy)
    return True


def _left(fish: Fish, copy: Path) -> Snapshot | None:
    """The copy, when the board still has a run's reference, or, between the two steps of restoring,
    its own without what it had learned along it."""
    try:
        left = Snapshot.read(copy)
    except InputError:
        return None
    if left.unique_id != fish.unique_id():
        return None
    crc = fish.status().reference_crc
    if _is_of_a_run(copy, crc):
        return left
    own = left.reference is not None and crc == record_crc(left.reference)
    halfway = own and left.learned is not None and fish.learned_record() is None
    return left if halfway else None


def _write_copy(copy: Path, held: Snapshot, note: Callable[[str], None]) -> None:
    """One that is there already is set aside, never overwritten."""
    if (copy / BOARD_FILE).exists():
        aside = _set_aside(copy)
        note(
            f"an older copy of what the board held is kept in {aside} (tailbeat board flash "
            "--restore)"
        )
    (copy / _REFERENCES).unlink(missing_ok=True)
    held.write(copy)


def _set_aside(copy: Path) -> Path:
    for number in range(1, _ASIDE_MAX):
        aside = copy.with_name(f"{copy.name}-{number}")
        if not aside.exists():
            copy.rename(aside)
            sync_folder(copy.parent)
            return aside
    raise InputError(f"{copy.parent} is full of copies.", "Take the older ones away.")


def _note_reference(copy: Path, crc: int) -> None:
    """Before the board gets a reference of a run. Lasting when it returns."""
    with (copy / _REFERENCES).open("a", encoding="ascii") as file:
        file.write(f"{crc:#010x}\n")
        file.flush()
        os.fsync(file.fileno())
    sync_folder(copy)


def _is_of_a_run(copy: Path, crc: int | None) -> bool:
    """Whether an interrupted procedure gave the board the reference ``crc``."""
    if crc is None:
        return False
    try:
        return f"{crc:#010x}" in (copy / _REFERENCES).read_text(encoding="ascii").split()
    except (OSError, ValueError):
        return False


def require_idle(fish: Fish, then: str) -> BoardStatus:
    """The status of an idle board without a pending trial. ``then``: what to do after the remedy.
    Raises InputError."""
    status = fish.status()
    if status.pending_trial is not None:
        raise InputError(
            f"trial {status.pending_trial} is neither learned nor discarded.",
            f"tailbeat trial learn, or tailbeat trial discard --reason WHY; then {then}.",
        )
    if status.state != "IDLE":
        raise InputError(
            f"the board is {status.state}, not IDLE.",
            f"tailbeat board disarm or tailbeat board clear; then {then}.",
        )
    return status


def _held(fish: Fish, params: Mapping[str, float], changes: Sequence[str]) -> Snapshot:
    """What the runs overwrite. A first input that arming makes of the reference is not kept: it is
    made anew, by the gain of that moment."""
    held = Snapshot.take(fish, {name: params[name] for name in changes}, fish.info())
    return replace(held, learned=None) if _is_first_input(fish, held, params) else held


def _is_first_input(fish: Fish, held: Snapshot, params: Mapping[str, float]) -> bool:
    """Whether the amplitudes are just what the law makes of the reference."""
    if held.reference is None or held.iteration != 1 or held.has_best:
        return False
    reference = decode_reference(held.reference)
    first = first_amplitudes(law.Law.from_params(params, reference.beat_s), reference.speed_m_s)
    return np.array_equal(first, fish.amplitudes().values)


def _put_back(fish: Fish, held: Snapshot, copy: Path | None) -> None:
    """Ctrl-C does not stop it halfway."""
    for attempt in range(1, _RESTORE_TRIES + 1):
        try:
            _restore(fish, held, copy)
        except KeyboardInterrupt:
            if attempt == _RESTORE_TRIES:
                raise
            continue
        except TailbeatError as error:
            where = f"; a copy is in {copy}" if copy is not None else ""
            raise TailbeatError(
                f"what the board had learned could not be put back ({error.message}){where}.",
                f"Connect again, then: {RESTORE_COMMAND} (or: tailbeat board flash --restore "
                f"{copy})"
                if copy is not None
                else "",
            ) from error
        break
    if copy is not None:
        (copy / BOARD_FILE).unlink(missing_ok=True)  # first: without it the rest is no copy
        shutil.rmtree(copy, ignore_errors=True)


def _restore(fish: Fish, held: Snapshot, copy: Path | None) -> None:
    state = _stopped(fish)
    if state == "ARMED":
        fish.disarm()
    elif state in ("ABORTED", "FAULT"):
        fish.clear()
    if (pending := fish.status().pending_trial) is not None:
        fish.discard(pending)
    _set_params(fish, held.params)
    if held.reference is None and copy is not None:
        _note_reference(copy, REST_CRC)
    fish.upload_reference(held.reference or rest())
    if held.learned is not None:
        fish.upload_learned(held.learned)


def _set_params(fish: Fish, values: Mapping[str, float]) -> None:
    for name, value in values.items():
        if fish.params.get(name).value != value:
            fish.params.set(name, value)


def _stopped(fish: Fish) -> str:
    """Ends a run that nobody waits for any more; the state it leaves."""
    state = fish.status().state
    if state == "RUNNING":
        fish.abort()
    for _ in range(_STOP_LOOKS):
        if (state := fish.status().state) not in ("RUNNING", "SETTLING", "LEARNING"):
            break
        fish.link.run(_STOP_LOOK_S / max(fish.clock.rate, 1.0))
    return state
