"""From the disk back to the board."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

from tailbeat.board.fish import Fish
from tailbeat.board.provision import OPEN, give_back, key_for, trust_of
from tailbeat.board.snapshot import Backup
from tailbeat.core import records
from tailbeat.core.errors import InputError, LinkLostError, Refused, TailbeatError
from tailbeat.core.faults import BAD_FORMAT
from tailbeat.link.messages import BoardStatus


@dataclass
class Restored:
    """What the board has again, and what it has not and why. One short phrase each."""

    back: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def put_back(fish: Fish, backup: Backup) -> Restored:
    """Makes the board hold the backup's parameters, reference and learned input.

    What it holds already is not sent. A value the board refuses is reported, not raised. Raises
    InputError when the board is not IDLE, and LinkLostError.
    """
    _require_idle(fish.status())
    result = Restored()
    if fish.info().unique_id != backup.unique_id:
        result.notes.append(f"the backup is of another board ({backup.unique_id})")
    _params(fish, backup.params, result)  # first: the reference is judged by them
    _reference(fish, backup, result)
    _learned(fish, backup, result)
    _trial_numbers(backup.next_trial, fish.status().next_trial, result)
    if backup.signed and trust_of(fish) == OPEN:
        _key(fish, backup.unique_id, result)
    return result


def _require_idle(status: BoardStatus) -> None:
    if status.state != "IDLE":
        raise InputError(
            f"the board is {status.state} and takes nothing back",
            "Look at it with tailbeat info; make it idle with tailbeat clear or tailbeat disarm.",
        )


def _params(fish: Fish, wanted: dict[str, float], result: Restored) -> None:
    present = {name: p.value for name, p in fish.params.list().items()}
    changed, held = False, 0
    for name, value in wanted.items():
        if name not in present:
            result.missing.append(f"{name} = {value:g} (this firmware has no such parameter)")
        elif _float_bytes(present[name]) == _float_bytes(value):
            held += 1
        elif _try(result, f"{name} = {value:g}", partial(fish.params.set, name, value)):
            changed, held = True, held + 1
    if changed:
        fish.params.save()
    result.back.append(f"{held} parameters")


def _float_bytes(value: float) -> bytes:
    return struct.pack("<f", value)


def _reference(fish: Fish, backup: Backup, result: Restored) -> None:
    if backup.reference is None:
        return
    if _try(result, "the reference", partial(fish.upload_reference, backup.reference)):
        result.back.append("the reference")


def _learned(fish: Fish, backup: Backup, result: Restored) -> None:
    record = backup.learned
    if record is None:
        return
    what = "all that was learned"
    forms = [record, *records.older_forms(record)]
    offer = partial(_offer, fish, forms)
    if fish.learned_record() not in forms and not _try(result, what, offer):
        return
    result.back.append(what)
    if any(records.learned_visits(record)) and fish.visits() is None:
        result.missing.append(
            "how often each beat was corrected (this firmware does not count it; the backup has it)"
        )


def _offer(fish: Fish, forms: list[bytes]) -> None:
    """The newest of ``forms`` that the firmware knows."""
    for form in forms[:-1]:
        try:
            fish.upload_learned(form)
            return
        except Refused as refused:
            if refused.number != BAD_FORMAT:
                raise
    fish.upload_learned(forms[-1])


def _trial_numbers(was: int, now: int, result: Restored) -> None:
    """They go on behind the last trial that was learned from; one may have been discarded since."""
    if now < was:
        result.missing.append(
            f"the trial numbers: the next is {now}, not {was}; begin a new experiment folder"
        )


def _key(fish: Fish, board: str, result: Restored) -> None:
    """The one that this computer has for the board the backup is of."""
    if fish.unique_id() != board or key_for(fish.link.signing.store, board) is None:
        result.missing.append("the key (this computer has not got it); set one: tailbeat key set")
    elif _try(result, "the key", partial(give_back, fish, board)):
        result.back.append("its key")


def _try(result: Restored, what: str, action: Callable[[], object]) -> bool:
    try:
        action()
    except LinkLostError:
        raise
    except TailbeatError as error:
        result.missing.append(f"{what} ({error.message})")
        return False
    return True
