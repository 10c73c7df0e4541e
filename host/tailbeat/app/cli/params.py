"""params get, set, list, preset, save, load, reset."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from tailbeat.app.cli._connect import connected
from tailbeat.app.cli._options import Connect, Json
from tailbeat.app.cli._terminal import echo, say, table
from tailbeat.board import presets
from tailbeat.core.param_names import current_name
from tailbeat.experiment.current import accept, note_all, note_set
from tailbeat.link.params import Parameter

Name = Annotated[str, typer.Argument(metavar="NAME", help="For example ILC_GAIN.")]


def _number(value: float) -> str:
    return f"{value:.7g}"


def _present(name: str) -> str:
    """The name as boards have it; tells when it is an old one."""
    old = name.upper()
    new = current_name(old)
    if new != old:
        echo(f"tailbeat: {old} is now {new}", err=True)
    return new


def _one(parameter: Parameter) -> dict[str, Any]:
    return {"name": parameter.name, "value": parameter.value, "unit": parameter.unit}


def get_(name: Name, connect: Connect = None, json: Json = False) -> None:
    """Print one parameter.

    Example: tailbeat params get ILC_GAIN
    """
    with connected(connect) as fish:
        found = fish.params.get(_present(name))
    say(json, _one(found), f"{found.name} = {_number(found.value)} {found.unit}".rstrip())


def set_(
    name: Name,
    value: Annotated[float, typer.Argument(help="In the parameter's unit.")],
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Change one parameter at once; 'params save' keeps it through a power cycle.

    Example: tailbeat params set ILC_GAIN 4.6
    """
    with connected(connect) as fish:
        held = fish.params.set(_present(name), value)
        note_set(fish, {held.name: held.value})
    say(json, _one(held), f"{held.name} = {_number(held.value)} {held.unit}".rstrip())


def preset(
    name: Annotated[str, typer.Argument(metavar="thesis", help="Which set of values.")],
    connect: Connect = None,
    json: Json = False,
) -> None:
    """Set all parameters of a named set: thesis = the learning law of the thesis and its limits.

    It allows amplitudes up to 0.785 rad: use it only when the fish's commissioning allows that.

    Example: tailbeat params preset thesis
    """
    values = presets.preset(name)
    with connected(connect) as fish:
        held = presets.apply(fish, values)
        note_set(fish, {now.name: now.value for _, now in held.values()})
    rows = [
        [now.name, _number(now.value), now.unit, _was(before, now)] for before, now in held.values()
    ]
    document = {"preset": name, "params": [_one(now) for _, now in held.values()]}
    say(json, document, lambda: table(["name", "value", "unit", ""], rows, left=(0, 2, 3)))


def _was(before: float, now: Parameter) -> str:
    return "" if before == now.value else f"(was {_number(before)})"


def list_(connect: Connect = None, json: Json = False) -> None:
    """Print all parameters with their units and meaning.

    Example: tailbeat params list
    """
    with connected(connect) as fish:
        found = fish.params.list()
    rows = [
        [
            p.name,
            _number(p.value),
            p.unit,
            "" if p.value == p.default else f"(default {_number(p.default)})",
            p.text,
        ]
        for p in found.values()
    ]
    header = ["name", "value", "unit", "", "meaning"]
    say(json, {"params": list(found.values())}, lambda: table(header, rows, left=(0, 2, 3, 4)))


def save(connect: Connect = None, json: Json = False) -> None:
    """Keep the present values through a power cycle; an experiment goes on with them.

    Example: tailbeat params save
    """
    with connected(connect) as fish:
        fish.params.save()
        accepted = accept(fish)
    words = [f"{name} {_number(now)} (was {_number(was)})" for name, (now, was) in accepted.items()]
    text = f"saved; from now on expected: {', '.join(words)}" if words else "saved"
    say(json, {"saved": True, "accepted": {name: now for name, (now, _) in accepted.items()}}, text)


def load(connect: Connect = None, json: Json = False) -> None:
    """Bring the saved values back.

    Example: tailbeat params load
    """
    with connected(connect) as fish:
        fish.params.load()
        note_all(fish)
    say(json, {"loaded": True}, "loaded")


def reset(connect: Connect = None, json: Json = False) -> None:
    """Set every parameter to its default; what is saved stays until 'params save'.

    Example: tailbeat params reset
    """
    with connected(connect) as fish:
        fish.params.reset()
        note_all(fish)
    say(json, {"reset": True}, "all parameters at their defaults")
