"""params get, set, list, preset, save, load, reset."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated

import typer

from tailbeat.app.cli._fish import ConnectedFish
from tailbeat.app.cli._lazy import arg, opt
from tailbeat.app.cli._terminal import Output, pick, table, warn
from tailbeat.core.errors import InputError
from tailbeat.core.extras import lazy
from tailbeat.core.param_names import current_name
from tailbeat.link.params import Parameter

if TYPE_CHECKING:
    from tailbeat.experiment import current as in_experiment
    from tailbeat.link import presets
else:  # of commands that change something
    in_experiment = lazy("tailbeat.experiment.current")
    presets = lazy("tailbeat.link.presets")

_KEYS = ("name", "value", "unit")
Name = Annotated[str, arg("For example ILC_GAIN.", "NAME")]


def _number(value: float) -> str:
    return f"{value:.7g}"


def _present(name: str) -> str:
    """The name as boards have it; tells when it is an old one."""
    old = name.upper()
    new = current_name(old)
    if new != old:
        warn(f"{old} is now {new}")
    return new


def _one(found: Parameter) -> Output:
    text = f"{found.name} = {_number(found.value)} {found.unit}".rstrip()
    return Output(pick(found, *_KEYS), text)


def get_(fish: ConnectedFish, name: Name) -> Output:
    """Print one parameter.

    Example: tailbeat params get ILC_GAIN
    """
    return _one(fish.params.get(_present(name)))


def set_(
    fish: ConnectedFish,
    name: Name,
    value: float = arg("In the parameter's unit."),
) -> Output:
    """Change one parameter at once; 'params save' keeps it through a power cycle.

    Example: tailbeat params set ILC_GAIN 4.6
    """
    held = fish.params.set(_present(name), value)
    in_experiment.note_set(fish, {held.name: held.value})
    return _one(held)


def preset(
    fish: ConnectedFish,
    name: str = arg("Which set of values.", "thesis"),
    yes: bool = opt("Do not ask."),
) -> Output:
    """Set all parameters of a named set: thesis = the learning law of the thesis and its limits.

    It allows amplitudes up to 0.785 rad and never rolls back: a real board is asked for first. Use
    it only when the fish's commissioning allows that.

    Example: tailbeat params preset thesis
    """
    values = presets.preset(name)
    if not (yes or fish.info().simulated):
        _ask(fish, name, values)
    held = fish.params.apply(values)
    in_experiment.note_set(fish, {now.name: now.value for _, now in held.values()})
    rows = [
        [now.name, _number(now.value), now.unit, _unlike("was", before, now.value)]
        for before, now in held.values()
    ]
    document = {"preset": name, "params": [pick(now, *_KEYS) for _, now in held.values()]}
    return Output(document, lambda: table(["name", "value", "unit", ""], rows, left=(0, 2, 3)))


def _ask(fish: ConnectedFish, name: str, values: Mapping[str, float]) -> None:
    """Raises InputError unless somebody is there and says yes."""
    amplitude = "AMP_MAX_RAD"
    rises = f"{amplitude} from {_number(fish.params.get(amplitude).value)}"
    question = f"Set {len(values)} parameters ({rises} to {_number(values[amplitude])})?"
    if not (sys.stdin.isatty() and typer.confirm(f"tailbeat: {question}", err=True)):
        raise InputError(f"preset {name} was not set.", "Say y at a terminal, or give --yes.")


def _unlike(word: str, other: float, value: float) -> str:
    return "" if other == value else f"({word} {_number(other)})"


def list_(fish: ConnectedFish) -> Output:
    """Print all parameters with their units and meaning.

    Example: tailbeat params list
    """
    found = list(fish.params.list().values())
    rows = [
        [p.name, _number(p.value), p.unit, _unlike("default", p.default, p.value), p.text]
        for p in found
    ]
    header = ["name", "value", "unit", "", "meaning"]
    return Output({"params": found}, lambda: table(header, rows, left=(0, 2, 3, 4)))


def save(fish: ConnectedFish) -> Output:
    """Keep the present values through a power cycle; an experiment goes on with them.

    Example: tailbeat params save
    """
    fish.params.save()
    accepted = in_experiment.accept(fish)
    words = [f"{name} {_number(now)} (was {_number(was)})" for name, (now, was) in accepted.items()]
    text = f"saved; from now on expected: {', '.join(words)}" if words else "saved"
    document = {"saved": True, "accepted": {name: now for name, (now, _) in accepted.items()}}
    return Output(document, text)


def load(fish: ConnectedFish) -> Output:
    """Bring the saved values back.

    Example: tailbeat params load
    """
    fish.params.load()
    in_experiment.note_all(fish)
    return Output({"loaded": True}, "loaded")


def reset(fish: ConnectedFish) -> Output:
    """Set every parameter to its default; what is saved stays until 'params save'.

    Example: tailbeat params reset
    """
    fish.params.reset()
    in_experiment.note_all(fish)
    return Output({"reset": True}, "all parameters at their defaults")
