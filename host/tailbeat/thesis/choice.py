"""Which examples are meant, and which of them take the options that were given."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from tailbeat.errors import InputError
from tailbeat.thesis import lengths
from tailbeat.thesis.arithmetic import expression
from tailbeat.thesis.example import Example
from tailbeat.thesis.limits import ITERATIONS_MAX, M_MAX
from tailbeat.thesis.options import Options


def choose(
    examples: Sequence[Example], what: str | None, given: Mapping[str, Any], options: Options
) -> list[tuple[Example, Options]]:
    """The examples of ``what``, a chapter's number or an example's id (None = all), with
    ``options`` and what each knows of ``given`` (names of ``Options``, checked by ``checked``).

    Raises:
        InputError: for a chapter or example there is not; for an option that an example asked for
            by name does not know or has no use for; for one that none of several knows; for
            settings that an example refuses.
    """
    found = _named(examples, what)
    alone = what is not None and found[0].id == what
    for name in given:
        if not any(name in example.knows for example in found):
            raise _unknown(name, found, alone)
    orders = [
        (one, replace(options, **{n: value for n, value in given.items() if n in one.knows}))
        for one in found
    ]
    for one, asked in orders:
        settings = _settings(one, asked)
        if alone and "seed" in given and settings["seed"] is None:
            raise InputError(
                f"{one.id} draws nothing with these lengths, so --seed changes nothing.",
                "Leave it away, or give --lengths uniform.",
            )
    return orders


def _settings(example: Example, options: Options) -> Mapping[str, Any]:
    try:
        return example.settings_of(options)
    except InputError as error:
        raise InputError(f"{example.id}: {error.message}", error.remedy) from error


def _named(examples: Sequence[Example], what: str | None) -> list[Example]:
    if what is None:
        return list(examples)
    found = [one for one in examples if what in (one.id, str(one.chapter), f"ch{one.chapter}")]
    if not found:
        chapters = ", ".join(str(n) for n in sorted({one.chapter for one in examples}))
        ids = ", ".join(one.id for one in examples)
        raise InputError(f"there is no '{what}'.", f"Chapters are {chapters}; examples {ids}.")
    return found


def _unknown(name: str, examples: Sequence[Example], alone: bool) -> InputError:
    if alone:
        known = ", ".join(f"--{one}" for one in sorted(examples[0].knows)) or "no option"
        return InputError(f"{examples[0].id} does not know --{name}.", f"It knows {known}.")
    known = ", ".join(f"--{one}" for one in sorted(set().union(*(e.knows for e in examples))))
    return InputError(f"none of these examples knows --{name}.", f"They know {known}.")


def checked(
    lengths_text: str | None = None,
    seed: int | None = None,
    step: str | None = None,
    iterations: int | None = None,
    m: int | None = None,
    beta: str | None = None,
    delta: str | None = None,
    uptake: str | None = None,
) -> dict[str, Any]:
    """What was given, as values of ``Options``.

    Raises:
        InputError: for values that make no sense for any example.
    """
    if lengths_text is not None:
        lengths.parse(lengths_text, 1.0, lambda seed, iteration: 1.0, 1)
    _within("seed", seed, 0, 2**63 - 1)
    _within("iterations", iterations, 1, ITERATIONS_MAX)
    _within("m", m, 0, M_MAX)
    given = {
        "lengths": lengths_text,
        "seed": seed,
        "step": None if step is None else positive("step", step),
        "iterations": iterations,
        "m": m,
        "beta": None if beta is None else _nonzero("beta", beta),
        "delta": None if delta is None else positive("delta", delta),
        "uptake": uptake,
    }
    return {name: value for name, value in given.items() if value is not None}


def positive(name: str, text: str) -> float:
    """The value of an arithmetic expression above 0; InputError otherwise."""
    value = expression(text)({})
    if not value > 0:
        raise InputError(f"--{name} {text} is {value:g}.", "Give a number above 0.")
    return value


def _nonzero(name: str, text: str) -> float:
    value = expression(text)({})
    if value == 0:
        raise InputError(f"--{name} {text} is 0.", "Give any other number.")
    return value


def _within(name: str, value: int | None, low: int, high: int) -> None:
    if value is not None and not low <= value <= high:
        raise InputError(f"--{name} {value} is out of range.", f"Give {low} to {high}.")
