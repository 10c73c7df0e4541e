"""What a board holds: taken from it, written to disk, read, compared, and restored.

In a folder (``tailbeat board flash``, before an identification): ``board.json`` (who it was, its
parameters), ``reference.bin``, ``learned.bin``, ``crash.bin``, the records of the protocol. In
one file (``board/state.json`` of an experiment): all but the crash record, with a checksum.
"""

from __future__ import annotations

import hashlib
import json
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

from tailbeat.board.fish import Fish
from tailbeat.board.provision import OPEN, give_back, trust_of
from tailbeat.core import decode, records
from tailbeat.core.errors import InputError, LinkLostError, Refused, TailbeatError, reason
from tailbeat.core.faults import BAD_FORMAT
from tailbeat.core.files import MAKE_ROOM, canonical, replace_file, write_whole
from tailbeat.core.param_names import with_current_names
from tailbeat.core.printable import Hex
from tailbeat.link.messages import BoardInfo

BOARD_FILE = "board.json"
_FOLDER_FORMAT = "tailbeat backup 1"
_FILE_FORMAT = "tailbeat board 1"
_RECORDS = ("reference", "learned", "crash")
_FOLDER_FIELDS = ("unique_id", "build_id", "next_trial", "params", "signed")
_FILE_FIELDS = ("unique_id", "params", "iteration", "reference", "learned", "last_learned_trial")
_FOLDERS_MAX = 99

Differences = dict[str, tuple[float, float]]
"""Parameters by name: (the value now, the value in the snapshot)."""


@dataclass(frozen=True)
class Snapshot:
    """The content of a board. Records are bytes as in the protocol; None = it had none.

    ``learned``: as ``Fish.learned_record``. ``iteration``, ``last_learned_trial``: those of its
    status. ``signed``: it had a key. The key itself is not in it: no board gives it away.
    """

    unique_id: str
    params: dict[str, float]
    build_id: str = ""
    next_trial: int = 0
    iteration: int = 0
    last_learned_trial: int | None = None
    reference: bytes | None = None
    learned: bytes | None = None
    crash: bytes | None = None
    signed: bool = False
    made: str = field(default="", compare=False)

    @classmethod
    def take(
        cls, fish: Fish, params: Mapping[str, float] | None = None, info: BoardInfo | None = None
    ) -> Snapshot:
        """What the board holds now, without its crash record. ``params``: by default all that it
        has. ``info``: what it said of itself already; without it the build is not in it."""
        if params is None:
            params = fish.params.values()
        reference = fish.reference_record()
        status = fish.status() if info is None else info.status
        return cls(
            unique_id=fish.unique_id() if info is None else info.unique_id,
            params=dict(params),
            build_id="" if info is None else info.build_id,
            next_trial=status.next_trial,
            iteration=status.iteration,
            last_learned_trial=status.last_learned_trial,
            reference=reference,
            learned=fish.learned_record(),
            signed=bool(fish.link.signing.signs),
        )

    @property
    def has_best(self) -> bool:
        """Whether something was learned along this reference, as far as its record can be read."""
        try:
            return self.learned is not None and (
                records.decode_learned(self.learned).best_iteration > 0
            )
        except InputError:
            return False

    def knows_more(self, than: Snapshot) -> bool:
        """Whether ``than`` has learned less: a board whose storage was erased counts iterations
        and trials from the beginning, one that got its reference again only iterations."""
        if self.learned is None or self.learned == than.learned:
            return False
        if self.has_best and not than.has_best:
            return True  # trial numbers run on from one reference to the next
        last, its_last = self.last_learned_trial or 0, than.last_learned_trial or 0
        ahead = self.iteration - max(1, than.iteration)
        return (last > its_last and ahead >= 0) or (last == its_last and ahead > 0)

    def write(self, folder: Path) -> None:
        """Puts all of it on the disk itself before returning, and reads it back to be sure."""
        folder.mkdir(parents=True, exist_ok=True)
        held = [name for name in _RECORDS if getattr(self, name) is not None]
        for name in held:
            replace_file(folder / f"{name}.bin", getattr(self, name))
        document = {
            "format": _FOLDER_FORMAT,
            "made": self.made or datetime.now().astimezone().isoformat(timespec="seconds"),
            **{name: getattr(self, name) for name in _FOLDER_FIELDS},
            "records": held,
        }
        replace_file(folder / BOARD_FILE, json.dumps(document, indent=2).encode() + b"\n")
        if Snapshot.read(folder) != replace(self, iteration=0, last_learned_trial=None):
            raise InputError(
                f"the backup in {folder} differs from what was written",
                "Use another disk: --out FOLDER",
            )

    @classmethod
    def read(cls, folder: Path) -> Snapshot:
        """The backup in ``folder``. Raises InputError when it is none, or incomplete."""
        path, remedy = folder / BOARD_FILE, "Name a folder that tailbeat board flash made."
        try:
            held = decode.decode(path.read_bytes(), _Folder, f"{path} is damaged", remedy)
            files = {
                name: (folder / f"{name}.bin").read_bytes()
                for name in held.records
                if name in _RECORDS
            }
        except OSError as error:
            raise _no_backup(
                folder, f"cannot read {error.filename or folder} ({reason(error)})"
            ) from error
        except InputError as error:
            raise _no_backup(folder, error.message) from error
        if held.format != _FOLDER_FORMAT:
            raise _no_backup(folder, f"{path} is damaged (its format is {held.format!r})")
        fields: dict[str, Any] = {name: getattr(held, name) for name in _FOLDER_FIELDS}
        fields["params"] = with_current_names(held.params)
        return cls(**fields | files, made=held.made)

    def file_content(self) -> bytes:
        """The snapshot as one file: JSON. ``sha256``: of all the rest, so that a digit changed by
        hand or by a bad disk is found."""
        held = {"format": _FILE_FORMAT, **{name: getattr(self, name) for name in _FILE_FIELDS}}
        return canonical(held | {"sha256": hashlib.sha256(canonical(held)).hexdigest()})

    def write_file(self, path: Path) -> None:
        """Writes the one file in one step, lasting. Raises InputError."""
        make_folder(path.parent)
        write_whole(path, self.file_content(), MAKE_ROOM)

    @classmethod
    def read_file(cls, path: Path) -> Snapshot | None:
        """Of ``write_file``; None = there is none. Raises InputError when it is damaged."""
        if not path.exists():
            return None
        remedy = "Put a copy back, or delete it and go on with what the board itself has."
        why = f"{path} is damaged: it is not what was copied from the board."
        try:
            held = decode.read(path, _File, remedy)
        except InputError as error:
            raise InputError(why, remedy) from error
        found = cls(**{name: getattr(held, name) for name in _FILE_FIELDS})
        if held.format != _FILE_FORMAT or json.loads(found.file_content())["sha256"] != held.sha256:
            raise InputError(why, remedy)
        return replace(found, params=with_current_names(found.params))


class _Folder(decode.StrictTable, forbid_unknown_fields=False):
    """``board.json``."""

    format: str
    made: str
    unique_id: str
    build_id: str
    next_trial: int
    params: dict[str, float]
    records: tuple[str, ...]
    signed: bool = False


class _File(decode.StrictTable, forbid_unknown_fields=False):
    """``state.json``."""

    format: str
    unique_id: str
    params: dict[str, float]
    iteration: int
    reference: Hex | None
    learned: Hex | None
    last_learned_trial: int | None
    sha256: str


def _no_backup(folder: Path, why: str) -> InputError:
    return InputError(
        f"{folder} is no backup of a board: {why}",
        "Give the folder that tailbeat board flash made; it holds board.json.",
    )


def make_folder(folder: Path) -> None:
    """Makes ``folder`` in one that exists. Raises InputError."""
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make {folder}.", "Make the folder writable.") from error


def new_folder(root: Path, unique_id: str, now: datetime | None = None) -> Path:
    """Makes ``root/DATE_TIME_ID``, ID being the beginning of the unique id; never an old one."""
    stamp = (now or datetime.now()).strftime("%Y-%m-%d_%H%M%S")
    for number in range(1, _FOLDERS_MAX + 1):
        suffix = "" if number == 1 else f"_{number}"
        folder = root / f"{stamp}_{unique_id[:8]}{suffix}"
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            continue
        return folder
    raise InputError(f"{root} holds 99 backups of this second", "Use another folder: --out FOLDER")


def same_value(value: float, other: float) -> bool:
    """Whether a board, which holds float32, has both as the same value."""
    return struct.pack("<f", value) == struct.pack("<f", other)


def differences(now: Mapping[str, float], expected: Mapping[str, float]) -> Differences:
    """The parameters that differ; what only one of the two knows is another firmware's."""
    return {
        name: (now[name], value)
        for name, value in expected.items()
        if name in now and not same_value(now[name], value)
    }


@dataclass
class RestoreReport:
    """What the board has again, and what it has not and why. One short phrase each."""

    back: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def attempt(self, what: str, action: Callable[[], object]) -> bool:
        """Whether the board took it; a refusal is reported. Raises LinkLostError."""
        try:
            action()
        except LinkLostError:
            raise
        except TailbeatError as error:
            self.missing.append(f"{what} ({error.message})")
            return False
        return True


def restore(fish: Fish, held: Snapshot) -> RestoreReport:
    """Makes the board hold the snapshot's parameters, reference, learned input and key.

    What it holds already is not sent. A value the board refuses is reported, not raised. Raises
    InputError when the board is not IDLE, and LinkLostError.
    """
    if (state := fish.status().state) != "IDLE":
        raise InputError(
            f"the board is {state} and takes nothing back",
            "Look at it with tailbeat info; make it idle with tailbeat board clear or tailbeat "
            "board disarm.",
        )
    report = RestoreReport()
    if fish.info().unique_id != held.unique_id:
        report.notes.append(f"the backup is of another board ({held.unique_id})")
    _restore_params(fish, held.params, report)  # first: the reference is judged by them
    if held.reference is not None and report.attempt(
        "the reference", partial(fish.upload_reference, held.reference)
    ):
        report.back.append("the reference")
    if held.learned is not None:
        _restore_learned(fish, held.learned, report)
    if (now := fish.status().next_trial) < held.next_trial:
        report.missing.append(
            f"the trial numbers: the next is {now}, not {held.next_trial}; begin a new experiment"
            " folder"
        )
    if held.signed and trust_of(fish) == OPEN:
        _restore_key(fish, held.unique_id, report)
    return report


def restore_params(
    fish: Fish, expected: Mapping[str, float]
) -> tuple[dict[str, float], dict[str, str]]:
    """Sets and saves parameters: (what the board took, why it refused others). Some fit only once
    others are set: what is refused is tried again after the rest."""
    given: dict[str, float] = {}
    refused: dict[str, str] = {}
    for name, value in [*expected.items(), *expected.items()]:
        if name in given:
            continue
        try:
            given[name] = fish.params.set(name, value).value
            refused.pop(name, None)
        except LinkLostError:
            raise
        except TailbeatError as error:
            refused[name] = error.message
    if given:
        fish.params.save()
    return given, refused


def _restore_params(fish: Fish, expected: Mapping[str, float], report: RestoreReport) -> None:
    present = fish.params.values()
    changed = differences(present, expected)
    given, refused = restore_params(fish, {name: value for name, (_, value) in changed.items()})
    for name, value in expected.items():
        why = refused.get(name) if name in present else "this firmware has no such parameter"
        if why is not None:
            report.missing.append(f"{name} = {value:g} ({why})")
    unchanged = sum(name in present and name not in changed for name in expected)
    report.back.append(f"{unchanged + len(given)} parameters")


def _restore_learned(fish: Fish, record: bytes, report: RestoreReport) -> None:
    what = "all that was learned"
    forms = [record, *records.older_forms(record)]
    offer = partial(_offer, fish, forms)
    if fish.learned_record() not in forms and not report.attempt(what, offer):
        return
    report.back.append(what)
    if any(records.learned_visits(record)) and fish.visits() is None:
        report.missing.append(
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


def _restore_key(fish: Fish, board: str, report: RestoreReport) -> None:
    """The one that this computer has for the board the snapshot is of."""
    if fish.unique_id() != board or fish.link.signing.store.newest_of(board) is None:
        report.missing.append("the key (not on this computer); set one: tailbeat board key set")
    elif report.attempt("the key", partial(give_back, fish, board)):
        report.back.append("its key")
