"""Which experiment a fish is in: what 'trial run' adds to when no folder is named."""

from __future__ import annotations

import json
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

from tailbeat.errors import InputError
from tailbeat.experiment.board import held_state
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.redo import write_redo
from tailbeat.faults import NO_REFERENCE, refusal
from tailbeat.simulatorsettings import simulator_settings

if TYPE_CHECKING:
    from tailbeat.fish import Fish
    from tailbeat.reference import Reference

_CURRENT = "experiment.json"
_IDENTIFIED = "identified.json"
_REFERENCE = "reference.bin"

Conditions = dict[str, str | float]


def current(fish: Fish) -> Experiment | None:
    """The one last made or used with this fish, if its folder is still there; from its logbook."""
    from tailbeat.logbook import logbook_of

    if (book := logbook_of(fish)) is None:
        return None
    try:
        folder = Path(json.loads((book.folder / _CURRENT).read_text(encoding="utf-8"))["folder"])
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return Experiment(folder) if Experiment.is_at(folder) else None


def swims_for(fish: Fish) -> Experiment | None:
    """The current one, if it is of this board and of the reference the board has now."""
    crc = fish.status().reference_crc
    if crc is None or (experiment := current(fish)) is None:
        return None
    ours = experiment.settings().get("unique_id") in (None, "", fish.unique_id())
    return experiment if ours and reference_crc(experiment) in (None, crc) else None


def use(fish: Fish, experiment: Experiment) -> None:
    """Makes it the current one. Does nothing for a board without a logbook."""
    from tailbeat.logbook import logbook_of

    if (book := logbook_of(fish)) is None:
        return
    book.put(_CURRENT, {"folder": str(experiment.folder.resolve())})


def require_fish(fish: Fish, experiment: Experiment) -> None:
    """Raises InputError when the board is another fish than the experiment's, by its unique id."""
    wanted, found = str(experiment.settings().get("unique_id", "")), fish.unique_id()
    if wanted and wanted != found:
        raise InputError(
            f"this is another fish: {experiment.name} is of {wanted}, the board is {found}.",
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
    if has is None:
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


def require_own(fish: Fish) -> None:
    """Raises InputError when the board still holds the reference of a run that was broken off:
    what it swam along that would be learned as if it were the fish's own."""
    from tailbeat.model.lent import broken_off

    if (puts_back := broken_off(fish)) is not None:
        raise InputError(
            "a trim or an identification was broken off, and the board still has its reference.",
            f"To give it back what it held before: {puts_back}",
        )


def reference_of(experiment: Experiment) -> bytes | None:
    """Its record; None: the folder was made by hand and has none."""
    try:
        return (experiment.raw / _REFERENCE).read_bytes()
    except OSError:
        return None


def reference_crc(experiment: Experiment) -> int | None:
    """Of ``reference_of``."""
    from tailbeat.records import record_crc

    record = reference_of(experiment)
    return None if record is None else record_crc(record)


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
    from tailbeat.boardreference import board_reference

    require_own(fish)
    if (held := board_reference(fish)) is None:
        raise refusal(NO_REFERENCE)
    return _named(fish, held)


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
    from tailbeat.experiment.meant import note_board, require_as_set
    from tailbeat.laws import Law, Past

    require_as_set(fish)
    info = fish.info()
    params = {key: p.value for key, p in fish.params.list().items()}
    note_board(fish, params)
    label = Past.from_params(params).label() + Law.from_params(params, reference.beat_s).label()
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
    from tailbeat.logbook import logbook_of

    book = logbook_of(fish)
    if book is not None and (path := book.folder / _IDENTIFIED).is_file():
        experiment.add_raw(_IDENTIFIED, path.read_bytes())


def _named(fish: Fish, held: Reference) -> Reference:
    """A board knows no names: the logbook does, and the thesis's is known by its CRC."""
    from tailbeat.logbook import logbook_of
    from tailbeat.reference import Reference, thesis

    book, usual = logbook_of(fish), thesis()
    name = book.reference_name(held.crc) if book is not None else None
    if name is None and held.crc == usual.crc:
        name = usual.name
    return held if name is None else Reference(held.beat_s, held.speed_m_s, name)


def _name_before(fish: Fish) -> str | None:
    """What the fish was called in the experiment it was in."""
    before = current(fish)
    return str(before.settings().get("fish", "")) or None if before is not None else None
