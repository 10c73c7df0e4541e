"""A second ``experiment new`` before anything was swum in the first."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from tailbeat.errors import InputError
from tailbeat.experiment.current import current, reference_crc

if TYPE_CHECKING:
    from tailbeat.experiment.folder import Experiment
    from tailbeat.fish import Fish
    from tailbeat.reference import Reference


def untouched(experiment: Experiment) -> bool:
    """Nothing was swum in it, noted or set: only what making it has put there."""
    if any(experiment.raw.glob("*.ulg")):
        return False
    return {entry["what"] for entry in experiment.journal.entries()} <= {"made", "opened"}


def made_before(
    fish: Fish, root: Path, reference: Reference, wanted: dict[str, Any]
) -> Experiment | None:
    """The experiment the fish is in, when it is untouched, in ``root``, of this reference and the
    board's parameters, and no setting of ``wanted`` differs: there is nothing to make. Raises
    InputError when only those differ: what was mistyped is mended, and no empty folder is left."""
    found = current(fish)
    if found is None or found.folder.resolve().parent != root.resolve():
        return None
    if reference_crc(found) != reference.crc or not untouched(found):
        return None
    held = found.settings()
    if held.get("params") != {key: param.value for key, param in fish.params.list().items()}:
        return None
    if all(held.get(key) == value for key, value in wanted.items()):
        return found
    raise InputError(
        f"nothing was swum yet in {found.folder}, with other settings.",
        f"Mend those: tailbeat experiment set {found.folder} ...; for one beside it: --another",
    )
