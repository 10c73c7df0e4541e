"""Arithmetic as people type it: numbers, a few functions and names, and nothing else of Python.

How long trials are: all of them full, drawn at random, or by an expression of the iteration.

What can be computed: iterations, steps, both of them together, and up to which errors.
"""

from __future__ import annotations

import ast
import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.studies.thesis.example import ExampleOptions

Value = Callable[[Mapping[str, float]], float]

ALLOWED = (
    "+ - * / // % **, comparisons, 'a if c else b', and, or, not, pi, "
    "abs min max floor ceil round sqrt sin cos"
)
_LONGEST = 300  # characters; keeps the tree shallow enough to walk


def _power(base: float, exponent: float) -> float:
    found: float | complex = float(base) ** float(exponent)
    if isinstance(found, complex):
        raise ValueError("no real power")
    return found


_PARTS = (ast.BinOp, ast.UnaryOp, ast.IfExp, ast.Compare)
_OPERATORS = (
    ast.Add, ast.Sub, ast.Mult, ast.Div, ast.FloorDiv, ast.Mod, ast.Pow, ast.UAdd, ast.USub,
    ast.Not, ast.Eq, ast.NotEq, ast.Lt, ast.LtE, ast.Gt, ast.GtE,
)  # fmt: skip
_FUNCTIONS: dict[str, Callable[..., float]] = {
    "abs": abs, "floor": math.floor, "ceil": math.ceil, "round": round, "sqrt": math.sqrt,
    "sin": math.sin, "cos": math.cos, "min": lambda *given: min(given),
    "max": lambda *given: max(given),
}  # fmt: skip
_MANY = ("min", "max")
_KNOWN = {"pi": math.pi, "bool": bool, "power": _power, "__builtins__": {}, **_FUNCTIONS}


class _Unknown(Exception):
    """A part of the expression that is not arithmetic."""


def expression(text: str, names: tuple[str, ...] = ()) -> Value:
    """The function that ``text`` is of ``names``. Numbers and powers are floats, so that nothing
    grows far beyond one; the function raises InputError where it has no finite value.

    Raises:
        InputError: when the text is anything but arithmetic, with what is allowed.
    """
    may = f"Allowed are numbers, {', '.join((*names, ''))}{ALLOWED}."
    if len(text) > _LONGEST:
        raise InputError(f"an expression of {len(text)} characters is too long.", may)
    try:
        with warnings.catch_warnings(action="ignore"):
            tree = ast.parse(text.strip(), mode="eval")
        checked = ast.fix_missing_locations(ast.Expression(_Arithmetic(names).visit(tree.body)))
        code = compile(checked, "<expression>", "eval")
    except _Unknown as error:
        raise InputError(f"'{text}' has {error}, which is not allowed.", may) from None
    except (SyntaxError, ValueError, OverflowError, RecursionError, MemoryError):
        raise InputError(f"'{text}' is no arithmetic expression.", may) from None

    def finite(given: Mapping[str, float]) -> float:
        try:
            found = float(eval(code, {**_KNOWN, **given}))
        except (ArithmeticError, ValueError):
            found = math.nan
        if not math.isfinite(found):
            where = "".join(f" at {name} = {given[name]:g}" for name in names)
            raise InputError(f"'{text}' has no finite value{where}.", "Change it.")
        return found

    return finite


class _Arithmetic(ast.NodeTransformer):
    """Refuses all that is not arithmetic of ``names``; makes floats of numbers and powers."""

    def __init__(self, names: tuple[str, ...]) -> None:
        self._names = (*names, "pi")

    def generic_visit(self, node: ast.AST) -> ast.AST:
        if isinstance(node, _OPERATORS):
            return node
        used = [getattr(node, "op", None), *getattr(node, "ops", ())]
        known = all(one is None or isinstance(one, _OPERATORS) for one in used)
        if not isinstance(node, _PARTS) or not known:
            raise _Unknown(f"'{ast.unparse(node)}'")
        return super().generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> ast.expr:
        if not isinstance(node.value, int | float):
            raise _Unknown(f"'{ast.unparse(node)}'")
        return ast.Constant(float(node.value))

    def visit_Name(self, node: ast.Name) -> ast.expr:
        if node.id not in self._names:
            raise _Unknown(f"the name '{node.id}'")
        return node

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        if not isinstance(node.op, ast.Pow):
            return self.generic_visit(node)
        return _call("power", [self.visit(node.left), self.visit(node.right)])

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.expr:
        return _call("bool", [ast.BoolOp(node.op, [self.visit(part) for part in node.values])])

    def visit_Call(self, node: ast.Call) -> ast.expr:
        name = node.func.id if isinstance(node.func, ast.Name) else ""
        few = len(node.args) == 1 or (name in _MANY and node.args)
        if name not in _FUNCTIONS or node.keywords or not few:
            raise _Unknown(f"'{ast.unparse(node)}'")
        return _call(name, [self.visit(part) for part in node.args])


def _call(name: str, arguments: list[ast.expr]) -> ast.Call:
    return ast.Call(ast.Name(name, ast.Load()), arguments, [])


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
    pattern = text.removeprefix(_PATTERN)
    value = expression(pattern, ("i",))

    def length(iteration: int) -> float:
        found = value({"i": float(iteration)})
        if not found > 0:
            raise InputError(
                f"the pattern '{pattern}' gives a trial of length {found:g} in iteration "
                f"{iteration}.",
                "Every trial has a positive length: take max(1, ...) of it.",
            )
        return found

    return length


def length_settings(options: ExampleOptions, usual: str) -> dict[str, Any]:
    """Lengths and seed that ``options`` come to; no seed where nothing is drawn. ``usual``: the
    lengths where they say nothing."""
    text = options.lengths or usual
    drawn = text in _DRAWN
    return {"lengths": "uniform" if drawn else text, "seed": options.seed if drawn else None}


ITERATIONS_MAX = 10_000
M_MAX = 15  # of the moving average; a learner's window holds one trial more
STEPS_MIN = 2  # of a trial


def last_iteration(asked: int | None, usual: int, first: int = 0) -> int:
    """``asked``, or ``usual`` when None. ``first``: of the example, 0 or 1.

    Raises:
        InputError: when it is before the first, or beyond ``ITERATIONS_MAX``.
    """
    last = usual if asked is None else asked
    if not first <= last <= ITERATIONS_MAX:
        raise InputError(
            f"{last} is not the last of iterations that can be run.",
            f"Give {first} to {ITERATIONS_MAX}.",
        )
    return last


def errors_beyond(reference: F64) -> float:
    """Errors above this are divergence: no digit of the reference is left in them."""
    return float(np.max(np.abs(reference)) / np.finfo(np.float64).eps)


@dataclass(frozen=True)
class Span:
    """The time of a trial, which steps divide. ``steps_max``: of a trial. ``budget``: steps of all
    trials together that take about ten minutes, measured; at least ``STEPS_MIN`` in each of
    ``ITERATIONS_MAX``. ``typed``: the duration as ``--step`` takes it, where it is no short
    number."""

    duration: float
    unit: str
    steps_max: int
    budget: int
    typed: str = ""

    def steps(self, step: float) -> int:
        """Of ``step`` in a trial.

        Raises:
            InputError: when they are no whole number to a part in 1e9, or too few or too many.
        """
        count = self.nearest(step)
        if abs(count * step - self.duration) > 1e-9 * self.duration:
            raise self._no_step(f"does not divide {self._text} {self.unit}", step, count)
        return count

    def nearest(self, step: float) -> int:
        """The number of steps of the length nearest to ``step`` that divides a trial.

        Raises:
            InputError: when they are too few or too many.
        """
        parts = self.duration / step if step > 0.0 else math.nan
        if not math.isfinite(parts):
            raise self._no_step("is none", step, self.steps_max)
        if round(parts) > self.steps_max:
            raise self._no_step("is too short", step, self.steps_max)
        if round(parts) < STEPS_MIN:
            raise self._no_step("is too long", step, STEPS_MIN)
        return round(parts)

    def afford(self, steps: int, iterations: int) -> None:
        """Raises InputError, with what would fit, when so many trials of so many steps would take
        more than some ten minutes."""
        if steps * iterations <= self.budget:
            return
        step = f", or --step {self._text}/{self.budget // iterations} or longer"
        raise InputError(
            f"{iterations} iterations of {steps} steps would take more than some ten minutes.",
            f"Give --iterations {self.budget // steps} or fewer{step}.",
        )

    @property
    def _text(self) -> str:
        return self.typed or f"{self.duration:g}"

    def _no_step(self, why: str, step: float, like: int) -> InputError:
        like = min(max(like, STEPS_MIN), self.steps_max)
        return InputError(
            f"a step of {step:g} {self.unit} {why}.",
            f"Give --step {self._text}/N, N from {STEPS_MIN} to {self.steps_max}, "
            f"like {self._text}/{like}.",
        )
