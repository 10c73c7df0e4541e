"""``redo.md``: how to do an experiment again."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from tailbeat.core.files import MAKE_ROOM, write_whole
from tailbeat.core.native import ffi, lib
from tailbeat.experiment.folder import Experiment
from tailbeat.sim.config import PLANTS, config_values, make_config

if TYPE_CHECKING:
    from pathlib import Path


REDO = "redo.md"
_UNRECORDED = (
    "No command that swam was written down (the live page, a script, an older tool), so its options"
    " are not known (`--rest`, `--until`, `--camera` and what goes with it); what came of them is,"
    " behind a trial and in `journal.jsonl`."
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
        yield "- **simulated**: no real fish swam"
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
        yield "The journal is empty: an older tool made this folder. The trials are in `raw/`."


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
        return f"trial {trial} swam, iteration {iteration}, {end}{_found(entry)}"
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
        "restored": "`tailbeat learn --restore-best`: the best amplitudes swim next"
        + (f" (trial {trial})" if trial else ""),
    }.get(what, "")


def _found(entry: Mapping[str, Any]) -> str:
    """What the preflight checks found, as far as it was journalled."""
    rested_s, pose = entry.get("rested_s"), entry.get("pose") or {}
    rested = "" if rested_s is None else f", rested {rested_s:.0f} s"
    return rested + (f", pose by {pose['source']}" if pose.get("source") else "")


def _number(value: float) -> str:
    """The fewest digits that give the board's single precision number again."""
    import numpy as np

    return np.format_float_positional(np.float32(value), trim="-")


def _code(lines: list[str] | Iterator[str]) -> str:
    return "```\n" + "\n".join(lines) + "\n```"
