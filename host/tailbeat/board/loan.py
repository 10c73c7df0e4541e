"""A board lent for swims of other amplitudes than those it learns: an identification, a trim.

Whatever it had learned, its reference, and the parameters that are to be changed meanwhile are put
back afterwards, also after Ctrl-C or an error; until then a copy lies on the disk. What was broken
off (a laptop that died) leaves the copy behind; the next loan puts that back first, and so does
'session resume'.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from tailbeat.board.fish import REST
from tailbeat.board.snapshot import Backup, forget, is_of_a_run, left_in, note_reference, put_safe
from tailbeat.core import law
from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError, TailbeatError
from tailbeat.core.records import decode_reference, record_crc
from tailbeat.core.reference import Reference
from tailbeat.core.trial_file import Trial, read_trial
from tailbeat.link.messages import TrialOutcome

if TYPE_CHECKING:
    from tailbeat.board.fish import Fish, Guard, OnEvent
    from tailbeat.core.frames import Camera
    from tailbeat.experiment.library import Logbook
    from tailbeat.link.messages import BoardStatus


PUTS_BACK = "tailbeat session resume"

_SAFE = "before-identify"  # one folder for all loans: one that was broken off is found by any other
_PUT_BACK_TRIES = 3
_STOP_LOOKS, _STOP_LOOK_S = 60, 0.5  # of board time; settling takes no longer


@dataclass(frozen=True)
class Lent:
    """A board while it is lent. ``held``: what it gets back; ``params``: all it had at the
    begin."""

    fish: Fish
    held: Backup
    params: dict[str, float]
    safe: Path | None

    def prepare(
        self,
        name: str,
        amplitude_rad: F64,
        speed_m_s: ArrayLike,
        changes: Mapping[str, float] | None = None,
    ) -> None:
        """Uploads what is to swim next. The reference is ``speed_m_s``, what the model predicts,
        so that the trial's error is the model's. ``changes``: parameters, set only once the
        reference tells that the board is lent."""
        speed = np.clip(speed_m_s, 0.0, self.params["REF_MAX_M_S"]).astype(np.float32)
        limit = np.float32(self.params["AMP_MAX_RAD"])
        record = Reference(1.0, speed, name).record()
        if self.safe is not None:
            note_reference(self.safe, record_crc(record))
        self.fish.upload_reference(record)
        _set_params(self.fish, changes or {})
        self.fish.upload_amplitudes(np.minimum(amplitude_rad.astype(np.float32), limit))

    def swim(
        self,
        camera: Camera | None,
        event: OnEvent,
        guard: Guard,
        judge: Callable[[TrialOutcome], None],
        keep: Callable[[Path], object],
        direction_rad: float = 0.0,
    ) -> Trial:
        """Swims what was prepared; the trial is kept and dropped on the board. ``judge`` may raise
        for how it ended, or act on the trial that is pending. Ctrl-C stops the tail and leaves."""
        fish = self.fish
        outcome = fish.run_trial(camera, event, guard, direction_rad=direction_rad)
        if outcome.interrupted:
            raise KeyboardInterrupt
        judge(outcome)
        with TemporaryDirectory() as folder:
            path = fish.pull_trial(outcome.number, Path(folder))
            keep(path)
            swum = read_trial(path)
        fish.discard(outcome.number)
        return swum


@contextmanager
def lent(
    fish: Fish,
    safe: Path | None,
    note: Callable[[str], None],
    what: str,
    changes: Sequence[str] = (),
) -> Iterator[Lent]:
    """``safe``: folder for the copy (safe_folder); one that is there already is put back when a
    loan was broken off, and never overwritten. ``what``: a verb, what it is lent for.
    ``changes``: parameters that will be set meanwhile. ``note``: told what a person should know.
    Raises InputError when the board cannot begin."""
    put_back_left(fish, safe, note)
    _require_ready(fish, what)
    params = {name: p.value for name, p in fish.params.list().items()}
    held = _held(fish, params, changes)
    if safe is not None:
        put_safe(safe, held, note)
    try:
        yield Lent(fish, held, params, safe)
    finally:
        _put_back(fish, held, safe)


def broken_off(fish: Fish) -> str | None:
    """The command that gives the board back what it held before a loan that was broken off; None =
    there was none. Until then its reference and amplitudes are a run's: no trial may begin."""
    from tailbeat.experiment.library import logbook_of

    safe = safe_folder(logbook_of(fish))
    return None if safe is None or _left(fish, safe) is None else PUTS_BACK


def put_back_left(fish: Fish, safe: Path | None, note: Callable[[str], None]) -> bool:
    """Gives the board what it held before a loan that was broken off; whether there was one. A run
    that waits to be decided on is dropped. Raises InputError while the tail beats."""
    left = None if safe is None else _left(fish, safe)
    if safe is None or left is None:
        return False
    status = fish.status()
    if status.state == "RUNNING":
        raise InputError(
            "the board swims a run of an identification or a trim.",
            f"If nobody waits for it: tailbeat trial abort, then {PUTS_BACK}",
        )
    stopped = f" (it was stopped: {status.fault.name})" if status.fault.number else ""
    note(
        f"an identification or a trim was broken off{stopped}: the board gets back what it held "
        f"before, of which a copy is in {safe}"
    )
    _put_back(fish, left, safe)
    return True


def _left(fish: Fish, safe: Path) -> Backup | None:
    """The copy, when the board still has a run's reference, or, between the two steps of putting
    back, its own without what it had learned along it."""
    left = left_in(safe)
    if left is None or left.unique_id != fish.unique_id():
        return None
    crc = fish.status().reference_crc
    if is_of_a_run(safe, crc):
        return left
    own = left.reference is not None and crc == record_crc(left.reference)
    halfway = own and left.learned is not None and fish.learned_record() is None
    return left if halfway else None


def safe_folder(book: Logbook | None) -> Path | None:
    """Where the copy lies."""
    return None if book is None else book.folder / _SAFE


def set_for_good(fish: Fish, wanted: Mapping[str, float]) -> dict[str, float]:
    """Sets and saves these parameters, and notes it in the experiment the fish is in; others that
    were changed but not saved stay so. What the board then holds."""
    from tailbeat.experiment.current import note_set

    now = {name: p.value for name, p in fish.params.list().items()}
    fish.params.load()
    stored = {name: p.value for name, p in fish.params.list().items()}
    for name, value in wanted.items():
        fish.params.set(name, value)
    fish.params.save()
    for name, value in now.items():
        if name not in wanted and stored[name] != value:
            fish.params.set(name, value)
    held = {name: fish.params.get(name).value for name in wanted}
    note_set(fish, held)
    return held


def _require_ready(fish: Fish, what: str) -> None:
    status = fish.status()
    if status.pending_trial is not None:
        raise InputError(
            f"trial {status.pending_trial} is neither learned nor discarded.",
            f"tailbeat learn, or tailbeat trial discard; then {what}.",
        )
    if status.state != "IDLE":
        raise InputError(
            f"the board is {status.state}, not IDLE.",
            f"tailbeat disarm or tailbeat clear; then {what}.",
        )


def _held(fish: Fish, params: dict[str, float], changes: Sequence[str]) -> Backup:
    """What the swims would overwrite."""
    info = fish.info()
    reference = fish.reference_record()
    learned = fish.learned_record()
    if reference is not None and _is_guess(fish, info.status, reference, params):
        learned = None  # arming makes it anew, by the gain of that moment
    return Backup(
        unique_id=info.unique_id,
        build_id=info.build_id,
        params={name: params[name] for name in changes},
        next_trial=info.status.next_trial,
        reference=reference,
        learned=learned,
    )


def _is_guess(fish: Fish, status: BoardStatus, reference: bytes, params: dict[str, float]) -> bool:
    """Whether the amplitudes are just what the law makes of the reference."""
    if status.iteration != 1 or status.best_iteration is not None:
        return False
    wanted = decode_reference(reference)
    first = law.first(law.Law.from_params(params, wanted.beat_s), wanted.speed_m_s)
    return np.array_equal(first, fish.amplitudes().values)


def _put_back(fish: Fish, held: Backup, safe: Path | None) -> None:
    """Ctrl-C does not stop it halfway."""
    for attempt in range(1, _PUT_BACK_TRIES + 1):
        try:
            _restore(fish, held, safe)
        except KeyboardInterrupt:
            if attempt == _PUT_BACK_TRIES:
                raise
            continue
        except TailbeatError as error:
            where = f"; a copy is in {safe}" if safe is not None else ""
            raise TailbeatError(
                f"what the board had learned could not be put back ({error.message}){where}.",
                f"Connect again, then: {PUTS_BACK} (or: tailbeat flash --restore {safe})"
                if safe is not None
                else "",
            ) from error
        break
    if safe is not None:
        forget(safe)


def _restore(fish: Fish, held: Backup, safe: Path | None) -> None:
    state = _stopped(fish)
    if state == "ARMED":
        fish.disarm()
    elif state in ("ABORTED", "FAULT"):
        fish.clear()
    if (pending := fish.status().pending_trial) is not None:
        fish.discard(pending)
    _set_params(fish, held.params)
    if held.reference is None and safe is not None:
        note_reference(safe, record_crc(REST.record()))
    fish.upload_reference(held.reference or REST)
    if held.learned is not None:
        fish.upload_learned(held.learned)


def _set_params(fish: Fish, wanted: Mapping[str, float]) -> None:
    for name, value in wanted.items():
        if fish.params.get(name).value != value:
            fish.params.set(name, value)


def _stopped(fish: Fish) -> str:
    """Ends a swim that nobody waits for any more; the state it leaves."""
    state = fish.status().state
    if state == "RUNNING":
        fish.abort()
    for _ in range(_STOP_LOOKS):
        if (state := fish.status().state) not in ("RUNNING", "SETTLING", "LEARNING"):
            break
        fish.link.run(_STOP_LOOK_S / max(fish.clock.rate, 1.0))
    return state
