"""Chooses examples, with the options that each of them takes, and reports how much is done.

Runs examples, alone or many on all cores. Who computes one, and when, changes no bit of it.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from functools import wraps
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from tailbeat.core.errors import InputError, did_you_mean
from tailbeat.core.parallel import CONTEXT, each_result, one_thread
from tailbeat.studies.thesis import options as lengths
from tailbeat.studies.thesis.example import Claim, Example, ExampleOptions, ExampleRun, Figure
from tailbeat.studies.thesis.options import ITERATIONS_MAX, M_MAX, expression


def choose(
    examples: Sequence[Example], what: str | None, given: Mapping[str, Any], options: ExampleOptions
) -> list[tuple[Example, ExampleOptions]]:
    """The examples of ``what``, a chapter's number or an example's id (None = all), with
    ``options`` and what each knows of ``given`` (names of ``Options``, checked by ``checked``).

    Raises:
        InputError: for a chapter or example there is not; for an option that an example asked for
            by name does not know or has no use for; for one that none of several knows; for
            settings that an example refuses.
    """
    found = _matching(examples, what)
    alone = what is not None and found[0].id == what
    for name in given:
        if not any(name in example.knows for example in found):
            raise _unknown(name, found, alone)
    orders = [
        (one, replace(options, **{n: value for n, value in given.items() if n in one.knows}))
        for one in found
    ]
    for one, asked in orders:
        with _named(one):
            settings = one.settings_of(asked)
        if alone and "seed" in given and settings["seed"] is None:
            raise InputError(
                f"{one.id} draws nothing with these lengths, so --seed changes nothing.",
                "Leave it away, or give --lengths uniform.",
            )
    return orders


@contextmanager
def _named(example: Example) -> Iterator[None]:
    """Puts the example's name before what refuses its settings."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{example.id}: {error.message}", error.remedy) from error
    except (MemoryError, OverflowError) as error:
        raise InputError(
            f"{example.id}: these settings are more than this computer can compute.",
            "Take a longer step or fewer iterations.",
        ) from error


def _matching(examples: Sequence[Example], what: str | None) -> list[Example]:
    if what is None:
        return list(examples)
    found = [one for one in examples if what in (one.id, str(one.chapter), f"ch{one.chapter}")]
    if not found:
        chapters = ", ".join(str(n) for n in sorted({one.chapter for one in examples}))
        ids = ", ".join(one.id for one in examples)
        meant = did_you_mean(what, [one.id for one in examples])
        raise InputError(
            f"there is no '{what}'.", f"{meant}Chapters are {chapters}; examples {ids}."
        )
    return found


def _unknown(name: str, examples: Sequence[Example], alone: bool) -> InputError:
    options = sorted(set().union(*(one.knows for one in examples)))
    known = ", ".join(f"--{one}" for one in options) or "no option"
    if alone:
        return InputError(f"{examples[0].id} does not know --{name}.", f"It knows {known}.")
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
    whole = {"seed": (seed, 0, 2**63 - 1), "iterations": (iterations, 1, ITERATIONS_MAX),
             "m": (m, 0, M_MAX)}  # fmt: skip
    for name, (value, low, high) in whole.items():
        if value is not None and not low <= value <= high:
            raise InputError(f"--{name} {value} is out of range.", f"Give {low} to {high}.")
    given = {
        "lengths": lengths_text, "seed": seed, "step": _number("step", step),
        "iterations": iterations, "m": m, "beta": _number("beta", beta, signed=True),
        "delta": _number("delta", delta), "uptake": uptake,
    }  # fmt: skip
    return {name: value for name, value in given.items() if value is not None}


def _number(name: str, text: str | None, signed: bool = False) -> float | None:
    """The value of an arithmetic expression above 0 or, ``signed``, other than 0; InputError
    otherwise."""
    if text is None:
        return None
    value = expression(text)({})
    if signed and value == 0:
        raise InputError(f"--{name} {text} is 0.", "Give any other number.")
    if not signed and not value > 0:
        raise InputError(f"--{name} {text} is {value:g}.", "Give a number above 0.")
    return value


Show = Callable[[float], None]  # part of the work done, 0 to 1

_listener: ContextVar[Show | None] = ContextVar("listener", default=None)


@contextmanager
def progress_shown(show: Show) -> Iterator[None]:
    """``show`` gets what is reported within."""
    token = _listener.set(show)
    try:
        yield
    finally:
        _listener.reset(token)


def report_progress(done: int, of: int) -> None:
    """Trials that are done. Costs nothing that counts beside a trial."""
    show = _listener.get()
    if show is not None:
        show(done / of)


REGISTRY = "tailbeat.studies.thesis.registry"  # the module whose EXAMPLES workers look in
_RUN_PART = 0.1  # of an example's time, about, where claims are judged
_FIGURES_PART = 0.1
_POLL_S = 0.2


@dataclass(frozen=True, kw_only=True)
class Result(ExampleRun):
    """What came of one example. Without traces, as it travels between processes."""

    options: ExampleOptions
    claims: list[Claim]
    figures: list[Figure]


@dataclass(frozen=True)
class Order:
    """One example to compute. ``figures``: folder to draw into, None = draw nothing."""

    example_id: str
    options: ExampleOptions
    claims: bool = True
    figures: Path | None = None
    registry: str = REGISTRY


Value = TypeVar("Value")


class Study:
    """What claims and figures of an example are computed with: the same run is computed once.
    Claims judge the thesis's own settings, so of the options only the precision of the laws is
    taken over."""

    def __init__(self, example: Example, options: ExampleOptions | None = None) -> None:
        self.example = example
        self._options = ExampleOptions(precision=(options or ExampleOptions()).precision)
        self._computed: dict[Any, Any] = {}

    @property
    def setting(self) -> Any:
        """The example's."""
        return self.example.setting

    def beside(self, example: Example) -> Study:
        """A study of another example with the same options."""
        return Study(example, self._options)

    def run(self, **changes: Any) -> ExampleRun:
        """A run of the example with the thesis's settings but for ``changes``."""
        return self.run_with(replace(self._options, **changes))

    @property
    def traces(self) -> Any:
        """Of the example's own run."""
        return self.run().traces

    def run_with(self, options: ExampleOptions) -> ExampleRun:
        """A run with exactly these options."""
        return self.once(self.example.run, options)

    def once(self, compute: Callable[..., Value], *arguments: Any) -> Value:
        """``compute(*arguments)``, computed for the first who asks."""
        key = compute, *arguments
        if key not in self._computed:
            self._computed[key] = compute(*arguments)
        value: Value = self._computed[key]
        return value

    def judge(self, show: Show = lambda done: None) -> list[Claim]:
        """The example's claims."""
        judged = []
        for statement in self.example.claims:
            judged.append(statement.judge(self))
            show(len(judged) / len(self.example.claims))
        return judged

    def draw(self, folder: Path) -> list[Figure]:
        """The example's figures."""
        return [sketch.draw(self, folder) for sketch in self.example.figures]


def once(compute: Callable[[Study], Value]) -> Callable[[Study], Value]:
    """Makes a function of a study compute once for each."""

    @wraps(compute)
    def computed(study: Study) -> Value:
        return study.once(compute, study)

    return computed


def compute(order: Order, show: Show = lambda done: None) -> Result:
    """Runs the example, then judges its claims and draws its figures. Raises InputError, with the
    example's name, when its settings make no sense."""
    examples: Sequence[Example] = importlib.import_module(order.registry).EXAMPLES
    example = next(one for one in examples if one.id == order.example_id)
    part = 1 - _FIGURES_PART if order.figures else 1.0
    begun = _RUN_PART if order.claims else part
    study = Study(example, order.options)
    with one_thread(), np.errstate(all="ignore"):
        with progress_shown(lambda done: show(begun * done)), _named(example):
            run = _with_a_row(study.run_with(order.options))
        claims = []
        if order.claims:
            claims = study.judge(lambda done: show(begun + (part - begun) * done))
        show(part)
        figures = study.draw(order.figures) if order.figures else []
    show(1.0)
    found = vars(run) | {"traces": None}
    return Result(**found, options=order.options, claims=claims, figures=figures)


def _with_a_row(run: ExampleRun) -> ExampleRun:
    """With a row even when the very first iteration diverged: nothing finite is known of it."""
    if len(run.iterations) or run.diverged is None:
        return run
    columns: dict[str, Any] = {
        name: np.full((1, *column.shape[1:]), np.nan)
        for name in ("max_abs_error", "executed", "lengths")
        if (column := getattr(run, name)) is not None
    }
    return replace(run, iterations=np.array([run.diverged]), **columns)


def run_many(
    orders: Sequence[Order],
    weights: Sequence[float],
    cores: int,
    progress: Show = lambda done: None,
) -> list[Result]:
    """All orders' results in their order. ``weights``: how long each takes, about; the longest
    begins first. With one core or one order this process computes itself.

    Raises:
        InputError: when settings make no sense, or a process died.
        KeyboardInterrupt: at Ctrl-C, after its processes have ended.
    """
    alone = cores <= 1 or len(orders) <= 1
    parts: Any = [0.0] * len(orders) if alone else CONTEXT.Array("d", len(orders), lock=False)

    def show() -> None:
        progress(sum(w * p for w, p in zip(weights, parts, strict=True)) / math.fsum(weights))

    if alone:
        return [_compute_part(parts, show, i, order) for i, order in enumerate(orders)]
    died = InputError(
        "a process that computed examples has died.",
        "It may have run out of memory: give fewer --cores.",
    )
    heaviest_first = sorted(range(len(orders)), key=lambda i: -weights[i])
    tasks = ((i, (i, orders[i])) for i in heaviest_first)
    found = dict(
        each_result(
            _work, tasks, min(cores, len(orders)), died,
            begin=_begin_worker, shared=(parts,), poll_s=_POLL_S, polled=show,
        )
    )  # fmt: skip
    return [found[index] for index in range(len(orders))]


def _compute_part(parts: Any, shown: Callable[[], None], index: int, order: Order) -> Result:
    def show(part: float) -> None:
        parts[index] = part
        shown()

    return compute(order, show)


_shared_parts: Any = None  # of a worker: how much of each order is done


def _begin_worker(parts: Any) -> None:
    global _shared_parts
    _shared_parts = parts


def _work(index: int, order: Order) -> Result:
    return _compute_part(_shared_parts, lambda: None, index, order)
