"""Which experiment a fish is in: what 'trial run' adds to when no folder is named.

Also which parameters a board is expected to have: what its experiment had last, and what was set
since. Any other value was lost (a battery swap takes what was not saved) or set by somebody else;
a trial would go on with it, and the law would learn by it, so it is reported first. An experiment
has the expected values in its journal and its copy of the board's state. Before there is one, and
between two, the fish's trial library has them: ``meant.json``, what commands set on this board.

And notes that are written before there is an experiment: they wait on disk until it begins.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from shlex import quote
from typing import Any

from tailbeat.board.fish import Fish, board_reference
from tailbeat.board.preserve import RESTORE_COMMAND, was_interrupted
from tailbeat.board.snapshot import Differences, differences, same_value
from tailbeat.core import decode
from tailbeat.core.errors import InputError, TailbeatError
from tailbeat.core.faults import NO_REFERENCE, refusal
from tailbeat.core.files import locked
from tailbeat.core.law import Averaging, Law
from tailbeat.core.param_names import with_current_names
from tailbeat.core.records import record_crc
from tailbeat.core.reference import Reference, from_text, thesis
from tailbeat.experiment.folder import Experiment, expected_params, held_state, set_held_params
from tailbeat.experiment.library import library_of, preserve_folder
from tailbeat.experiment.redo import write_redo
from tailbeat.experiment.store import Journal
from tailbeat.sim.config import simulator_settings


def put_by(root: Path, unique_id: str, text: str, at: datetime) -> None:
    """Keeps it for the next experiment of this fish. Raises InputError, OSError."""
    root.mkdir(parents=True, exist_ok=True)
    with locked(root):
        _waiting(root, unique_id).add("note", at, text=text)


def bring(root: Path, unique_id: str, experiment: Experiment) -> int:
    """Writes what waits into the experiment, with the time of each; how many. What a full disk
    stops waits on. Raises InputError, OSError."""
    waiting = _waiting(root, unique_id)
    if not waiting.path.exists():
        return 0
    with locked(root):
        return _bring(waiting, experiment)


def _bring(waiting: Journal, experiment: Experiment) -> int:
    notes = waiting.entries("note")
    there = {(entry["time"], entry["text"]) for entry in experiment.journal.entries("note")}
    for note in notes:
        if (note["time"], note["text"]) not in there:  # else it was stopped half way
            experiment.note(note["text"], datetime.fromisoformat(note["time"]))
    waiting.path.unlink(missing_ok=True)
    return len(notes)


def _waiting(root: Path, unique_id: str) -> Journal:
    return Journal(root / f"notes-{unique_id}.jsonl")


_CURRENT = "experiment.json"
_IDENTIFIED = "identified.json"
_REFERENCE = "reference.bin"

Conditions = dict[str, str | float]


def current(fish: Fish) -> Experiment | None:
    """The one last made or used with this fish, by its trial library; None: its folder is gone."""
    if (book := library_of(fish)) is None:
        return None
    try:
        folder = Path(json.loads((book.folder / _CURRENT).read_text(encoding="utf-8"))["folder"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return Experiment(folder) if Experiment.is_at(folder) else None


def experiment_for(fish: Fish) -> Experiment | None:
    """The current one, if it is of this board and of the reference the board has now."""
    crc = fish.status().reference_crc
    if crc is None or (experiment := current(fish)) is None:
        return None
    ours = experiment.settings().get("unique_id") in (None, "", fish.unique_id())
    return experiment if ours and reference_crc(experiment) in (None, crc) else None


def use(fish: Fish, experiment: Experiment) -> None:
    """Makes it the current one. Does nothing for a board without a trial library."""
    if (book := library_of(fish)) is None:
        return
    book.put(_CURRENT, {"folder": str(experiment.folder.resolve())})


def require_fish(fish: Fish, experiment: Experiment) -> None:
    """Raises InputError when the board is another fish than the experiment's, by its unique id."""
    expected, found = str(experiment.settings().get("unique_id", "")), fish.unique_id()
    if expected and expected != found:
        raise InputError(
            f"this is another fish: {experiment.name} is of {expected}, the board is {found}.",
            "Connect the right fish, or make an experiment for this one: tailbeat experiment new",
        )


def require_same(fish: Fish, experiment: Experiment) -> None:
    """Raises InputError, with what to do, when the board is another fish than the experiment's (by
    its unique id), or has another reference."""
    require_fish(fish, experiment)
    crc, has = reference_crc(experiment), fish.status().reference_crc
    if crc is None or crc == has:
        return
    csv = quote(str(experiment.folder / "reference.csv"))
    if has_lost(fish, experiment):
        both = held_state(experiment) is not None
        raise InputError(
            "the board has lost its reference" + (" and all that it had learned." if both else "."),
            f"{experiment.name} has a copy{' of both' if both else ''}. To give it back: tailbeat"
            f" session resume. To begin anew: tailbeat reference upload {csv}, then tailbeat"
            " experiment new",
        )
    raise InputError(
        f"the board has another reference ({has:08x}) than {experiment.name} ({crc:08x}).",
        f"tailbeat reference upload {csv}, or make an experiment for the board's: tailbeat"
        " experiment new",
    )


def has_lost(fish: Fish, experiment: Experiment) -> bool:
    """Whether the board has no reference, and ``experiment`` has it."""
    return fish.status().reference_crc is None and reference_crc(experiment) is not None


def require_own(fish: Fish) -> None:
    """Raises InputError when the board still holds the reference of a run that was broken off:
    what it swam along that would be learned as if it were the fish's own."""
    if is_interrupted(fish):
        raise InputError(
            "a trim or an identification was broken off, and the board still has its reference.",
            f"To give it back what it held before: {RESTORE_COMMAND}",
        )


def is_interrupted(fish: Fish) -> bool:
    """Whether the board still has the reference of an identification or a trim that was broken
    off: until it is restored no trial may begin."""
    return was_interrupted(fish, preserve_folder(library_of(fish)))


def reference_of(experiment: Experiment) -> bytes | None:
    """Its record; None: the folder was made by hand and has none."""
    try:
        return (experiment.raw / _REFERENCE).read_bytes()
    except OSError:
        return None


def reference_crc(experiment: Experiment) -> int | None:
    """Of ``reference_of``."""

    record = reference_of(experiment)
    return None if record is None else record_crc(record)


def named_reference(text: str) -> Reference:
    """As ``core.reference.from_text``; the ``reference.csv`` of an experiment gets the name that it
    has there, its own says nothing."""
    reference, folder = from_text(text), Path(text).resolve().parent
    if not Path(text).is_file() or not Experiment.is_at(folder):
        return reference
    experiment = Experiment(folder)
    if reference_crc(experiment) != reference.crc:
        return reference
    return replace(reference, name=str(experiment.settings().get("reference", reference.name)))


def begin(
    fish: Fish,
    root: Path,
    name: str | None = None,
    conditions: Conditions | None = None,
) -> Experiment:
    """A new experiment of the board's reference, law and parameters, and the current one from now
    on; with a copy of what was identified (``raw/identified.json``) where there is one. ``name``:
    the fish's, by default as in its last experiment. Raises Refused without a reference, InputError
    with one that is not its own (``require_own``)."""
    return make(fish, root, own_reference(fish), name or _name_before(fish), conditions)


def own_reference(fish: Fish) -> Reference:
    """The board's reference, with its name. Raises Refused without one, InputError with one that is
    not its own (``require_own``)."""

    require_own(fish)
    if (held := held_reference(fish)) is None:
        raise refusal(NO_REFERENCE)
    return held


def make(
    fish: Fish,
    root: Path,
    reference: Reference,
    name: str | None = None,
    conditions: Conditions | None = None,
    words: dict[str, str] | None = None,
) -> Experiment:
    """As ``begin``, of a reference that the board may get later. ``words``: what else is to be set:
    operator, configuration. Raises InputError when the board is not as it was set last."""

    require_as_set(fish)
    info = fish.info()
    params = fish.params.values()
    note_board(fish, params)
    label = (
        Averaging.from_params(params).label() + Law.from_params(params, reference.beat_s).label()
    )
    experiment = Experiment.new(root, name or info.board, reference.name, label)
    settings: dict[str, Any] = {
        "simulated": info.simulated,
        "params": params,
        "firmware": info.build_id,
        "board": info.board,
        "unique_id": info.unique_id,
        "conditions": dict(conditions or {}),
        **(words or {}),
    }
    if (sim := fish.sim) is not None:
        settings |= {"plant": sim.plant, "seed": sim.seed, "simulator": sim.config}
    elif info.simulated:
        settings |= simulator_settings(fish.transport)
    experiment.write_settings(settings)
    experiment.add_raw(_REFERENCE, reference.record())
    reference.to_csv(experiment.folder / "reference.csv")
    _copy_identified(fish, experiment)
    experiment.journal.add("made", **settings)
    write_redo(experiment)
    use(fish, experiment)
    return experiment


def _copy_identified(fish: Fish, experiment: Experiment) -> None:
    book = library_of(fish)
    if book is not None and (path := book.folder / _IDENTIFIED).is_file():
        experiment.add_raw(_IDENTIFIED, path.read_bytes())


def held_reference(fish: Fish) -> Reference | None:
    """As ``board_reference``, with its name. A board knows no names: the trial library does, and
    the thesis's is known by its CRC."""
    if (held := board_reference(fish)) is None:
        return None
    book, usual = library_of(fish), thesis()
    name = book.reference_name(held.crc) if book is not None else None
    if name is None and held.crc == usual.crc:
        name = usual.name
    return held if name is None else Reference(held.beat_s, held.speed_m_s, name)


def _name_before(fish: Fish) -> str | None:
    """What the fish was called in the experiment it was in."""
    before = current(fish)
    return str(before.settings().get("fish", "")) or None if before is not None else None


_MEANT = "meant.json"
_NAMED_MAX = 3
_OFF = "it was switched off, or somebody else has set it"
_REMEDY = (
    "To restore it, as after a battery swap: tailbeat session resume. If it is intended:"
    " tailbeat params save"
)


def note_set(fish: Fish, params: Mapping[str, float], experiment: Experiment | None = None) -> None:
    """What was set on purpose, into the trial library and into ``experiment``, by default the one
    the fish swims for. Raises InputError (disk full); the board then counts as strayed."""
    note_board(fish, params)
    if (experiment := experiment or experiment_for(fish)) is None:
        return
    known = expected_params(experiment)
    new = {n: v for n, v in params.items() if n not in known or not same_value(known[n], v)}
    if new:
        experiment.journal.add("set", params=new)
        set_held_params(experiment, new)


def note_board(fish: Fish, params: Mapping[str, float]) -> None:
    """What the board is meant to have, into the trial library alone. Does nothing for a board
    without one. Raises InputError."""
    if (book := library_of(fish)) is not None:
        with book.changing():
            book.put(_MEANT, _board_params(fish) | dict(params))


def set_and_save(fish: Fish, values: Mapping[str, float]) -> dict[str, float]:
    """Sets and saves these parameters, and notes it in the experiment the fish is in; others that
    were changed but not saved stay so, and all of them where one is refused. What the board then
    holds."""
    now = fish.params.values()
    fish.params.load()
    stored = fish.params.values()
    unsaved = [name for name in now if name not in values and stored[name] != now[name]]
    try:
        for name, value in values.items():
            fish.params.set(name, value)
        fish.params.save()
    except TailbeatError:
        unsaved += [name for name in values if name in now]
        raise
    finally:
        for name in unsaved:
            fish.params.set(name, now[name])
    held = fish.params.values(*values) if values else {}
    note_set(fish, held)
    return held


def note_all(fish: Fish) -> None:
    """Whatever the board has now was set on purpose."""
    note_set(fish, fish.params.values())


def note_restored(fish: Fish) -> None:
    """The board has its expected values again: the trial library follows. Raises InputError."""
    note_board(fish, fish.params.values())


def strayed(fish: Fish, experiment: Experiment | None) -> Differences:
    """From what ``experiment`` had, or without one from what was set. What only one of the two
    knows is another firmware's."""
    expected = _board_params(fish) if experiment is None else expected_params(experiment)
    return differences(fish.params.values(), expected)


def require_expected(fish: Fish, experiment: Experiment) -> None:
    """Raises InputError when the board's parameters are not as ``experiment`` had them."""
    if not (found := strayed(fish, experiment)):
        return
    known = _board_params(fish)
    if all(name in known and same_value(known[name], now) for name, (now, _) in found.items()):
        raise InputError(
            f"the board is set for another experiment than {experiment.name} ({_words(found)}).",
            f"To go on with what {experiment.name} had: tailbeat session resume. With what the"
            " board has: tailbeat params save",
        )
    raise InputError(
        f"the board is not as {experiment.name} last had it ({_words(found)}): {_OFF}.", _REMEDY
    )


def require_as_set(fish: Fish) -> None:
    """Raises InputError when the board's parameters are not as commands have set them; for a board
    that swims for no experiment yet."""
    if found := strayed(fish, None):
        raise InputError(f"the board is not as it was set last ({_words(found)}): {_OFF}.", _REMEDY)


def require_expected_here(fish: Fish) -> None:
    """As ``require_expected``, in the experiment the fish swims for, or ``require_as_set``."""
    if (experiment := experiment_for(fish)) is not None:
        require_expected(fish, experiment)
    else:
        require_as_set(fish)


def accept(fish: Fish) -> Differences:
    """Whatever the board has is meant so from now on; what had strayed."""
    found = strayed(fish, experiment_for(fish))
    note_all(fish)
    return found


def _words(found: Differences) -> str:
    words = [f"{name} is {now:g}, was {was:g}" for name, (now, was) in found.items()]
    if len(words) > _NAMED_MAX:
        words = [*words[:_NAMED_MAX], f"{len(words) - _NAMED_MAX} more"]
    return ", ".join(words)


def _board_params(fish: Fish) -> dict[str, float]:
    """As the trial library has them; empty = nothing was set. Raises InputError: it is damaged."""
    book = library_of(fish)
    if book is None or not (path := book.folder / _MEANT).is_file():
        return {}
    remedy = "Look at its parameters (tailbeat params list), then delete the file."
    try:
        return with_current_names(decode.read(path, dict[str, float], remedy))
    except InputError as error:
        raise InputError(
            f"{path} is damaged: the expected parameters are unknown.", remedy
        ) from error


def untouched(experiment: Experiment) -> bool:
    """Nothing was executed in it, noted or set: only what making it has put there."""
    if any(experiment.raw.glob("*.ulg")):
        return False
    return {entry["what"] for entry in experiment.journal.entries()} <= {"made", "opened"}


def made_before(
    fish: Fish, root: Path, reference: Reference, settings: dict[str, Any]
) -> Experiment | None:
    """The experiment the fish is in, when it is untouched, in ``root``, of this reference and the
    board's parameters, and none of these ``settings`` differs: there is nothing to make. Raises
    InputError when only those differ: what was mistyped is mended, and no empty folder is left."""
    found = current(fish)
    if found is None or found.folder.resolve().parent != root.resolve():
        return None
    if reference_crc(found) != reference.crc or not untouched(found):
        return None
    held = found.settings()
    if held.get("params") != fish.params.values():
        return None
    if all(held.get(key) == value for key, value in settings.items()):
        return found
    raise InputError(
        f"nothing was executed yet in {found.folder}, with other settings.",
        f"Mend those: tailbeat experiment set {found.folder} ...; for one beside it: --another",
    )
