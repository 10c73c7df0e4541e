"""How long trials are: all of them full, drawn at random, or by an expression of the iteration."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tailbeat.core.errors import InputError
from tailbeat.studies.thesis.arithmetic import expression
from tailbeat.studies.thesis.example import Options

Length = Callable[[int], float]
"""Iteration -> length of its trial, in the example's unit (samples, s, beats)."""

_PATTERN = "pattern:"
_DRAWN = ("uniform", "random")
_REMEDY = "Lengths are full, uniform or pattern:EXPR of the iteration i, like pattern:45+3*(i%4)."


def parse(text: str, full: float, draw: Callable[[int, int], float], seed: int) -> Length:
    """``full``: every trial has ``full``. ``uniform`` (or ``random``): ``draw(seed, iteration)``,
    the example's own distribution, whatever it is. ``pattern:EXPR``: an arithmetic expression of
    the iteration ``i``: ``+ - * / // % **``, comparisons, ``a if c else b``, ``and or not``,
    ``pi``, and ``abs min max floor ceil round sqrt sin cos``; a pattern that is not positive and
    finite for an iteration is refused when that iteration comes.

    Raises:
        InputError: for anything else, with what is allowed.
    """
    if text == "full":
        return lambda iteration: full
    if text in _DRAWN:
        return lambda iteration: draw(seed, iteration)
    if not text.startswith(_PATTERN):
        raise InputError(f"'{text}' are no lengths of trials.", _REMEDY)
    return _pattern(text.removeprefix(_PATTERN))


def settings(options: Options, usual: str) -> dict[str, Any]:
    """Lengths and seed that ``options`` come to; no seed where nothing is drawn. ``usual``: the
    lengths where they say nothing."""
    text = options.lengths or usual
    drawn = text in _DRAWN
    return {"lengths": "uniform" if drawn else text, "seed": options.seed if drawn else None}


def _pattern(text: str) -> Length:
    value = expression(text, ("i",))

    def length(iteration: int) -> float:
        found = value({"i": float(iteration)})
        if not found > 0:
            raise InputError(
                f"the pattern '{text}' gives a trial of length {found:g} in iteration {iteration}.",
                "Every trial has a positive length: take max(1, ...) of it.",
            )
        return found

    return length
