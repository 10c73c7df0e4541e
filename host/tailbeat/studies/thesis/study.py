"""Which examples are meant, and which of them take the options that were given.

How much of the run that was asked for is done. Whoever computes tells it; nobody need listen.

Runs examples, alone or many on all cores. Who computes one, and when, changes no bit of it.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.core.parallel import one_thread
from tailbeat.studies.pool import CONTEXT, each_result
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


def _settings(example: Example, options: ExampleOptions) -> Mapping[str, Any]:
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


Show = Callable[[float], None]  # part of the work done, 0 to 1

_listener: ContextVar[Show | None] = ContextVar("listener", default=None)


@contextmanager
def heard(show: Show) -> Iterator[None]:
    """``show`` gets what is told within."""
    token = _listener.set(show)
    try:
        yield
    finally:
        _listener.reset(token)


def tell(done: int, of: int) -> None:
    """Trials that are done. Costs nothing that counts beside a trial."""
    show = _listener.get()
    if show is not None:
        show(done / of)


REGISTRY = "tailbeat.studies.thesis.registry"  # the module whose EXAMPLES workers look in
_RUN_PART = 0.1  # of an example's time, about, where claims are judged
_FIGURES_PART = 0.1
_POLL_S = 0.2


@dataclass(frozen=True)
class Result:
    """What came of one example. Without traces, as it travels between processes."""

    example_id: str
    options: ExampleOptions
    iterations: NDArray[np.int64]
    max_abs_error: F64
    executed: F64 | None
    lengths: F64 | None
    diverged: int | None
    claims: list[Claim] = field(default_factory=list)
    figures: list[Figure] = field(default_factory=list)


@dataclass(frozen=True)
class Order:
    """One example to compute. ``figures``: folder to draw into, None = draw nothing."""

    example_id: str
    options: ExampleOptions
    claims: bool = True
    figures: Path | None = None
    registry: str = REGISTRY


class CachedStudy:
    """``Study`` of an example: the same run is computed once. Claims judge the thesis's own
    settings, so of the options only the precision of the laws is taken over."""

    def __init__(self, example: Example, options: ExampleOptions, tick: Show | None = None) -> None:
        self._example = example
        self._options = ExampleOptions(precision=options.precision)
        self._tick = tick or (lambda done: None)
        self._runs: dict[ExampleOptions, ExampleRun] = {}

    def run(self, **changes: Any) -> ExampleRun:
        return self.run_with(replace(self._options, **changes))

    def run_with(self, options: ExampleOptions) -> ExampleRun:
        """A run with exactly these options."""
        if options not in self._runs:
            self._runs[options] = self._example.run(options)
        return self._runs[options]

    def tick(self, done: float) -> None:
        self._tick(min(max(done, 0.0), 1.0))


def compute(order: Order, tick: Show | None = None) -> Result:
    """Runs the example, then judges its claims and draws its figures. Raises InputError, with the
    example's name, when its settings make no sense."""
    example = _find(order)
    show = tick or (lambda done: None)
    part = 1 - _FIGURES_PART if order.figures else 1.0
    begun = _RUN_PART if order.claims else part
    study = CachedStudy(example, order.options, lambda done: show(begun + (part - begun) * done))
    with one_thread(), np.errstate(all="ignore"):
        with heard(lambda done: show(begun * done)):
            run = _told(_run(example, study, order.options))
        claims = example.claims(study) if order.claims else []
        show(part)
        figures = example.figures(study, order.figures) if order.figures else []
    show(1.0)
    return Result(
        example_id=example.id,
        options=order.options,
        iterations=run.iterations,
        max_abs_error=run.max_abs_error,
        executed=run.executed,
        lengths=run.lengths,
        diverged=run.diverged,
        claims=claims,
        figures=figures,
    )


def _told(run: ExampleRun) -> ExampleRun:
    """With a row even when the very first iteration diverged: nothing finite is known of it."""
    if len(run.iterations) or run.diverged is None:
        return run

    def unknown(column: F64) -> F64:
        return np.full((1, *column.shape[1:]), np.nan)

    return replace(
        run,
        iterations=np.array([run.diverged]),
        max_abs_error=unknown(run.max_abs_error),
        executed=None if run.executed is None else unknown(run.executed),
        lengths=None if run.lengths is None else unknown(run.lengths),
    )


def _find(order: Order) -> Example:
    examples: Sequence[Example] = importlib.import_module(order.registry).EXAMPLES
    return next(one for one in examples if one.id == order.example_id)


def _run(example: Example, study: CachedStudy, options: ExampleOptions) -> ExampleRun:
    try:
        return study.run_with(options)
    except InputError as error:
        raise InputError(f"{example.id}: {error.message}", error.remedy) from error
    except (MemoryError, OverflowError) as error:
        raise InputError(
            f"{example.id}: these settings are more than this computer can compute.",
            "Take a longer step or fewer iterations.",
        ) from error


def run_many(
    orders: Sequence[Order],
    weights: Sequence[float],
    cores: int,
    progress: Show | None = None,
) -> list[Result]:
    """All orders' results in their order. ``weights``: how long each takes, about; the longest
    begins first. With one core or one order this process computes itself.

    Raises:
        InputError: when settings make no sense, or a process died.
        KeyboardInterrupt: at Ctrl-C, after its processes have ended.
    """
    show = progress or (lambda done: None)
    if cores <= 1 or len(orders) <= 1:
        return _here(orders, weights, show)
    parts = CONTEXT.Array("d", len(orders), lock=False)
    died = InputError(
        "a process that computed examples has died.",
        "It may have run out of memory: give fewer --cores.",
    )
    total = math.fsum(weights)
    found = dict(
        each_result(
            _work,
            ((i, (i, orders[i])) for i in sorted(range(len(orders)), key=lambda i: -weights[i])),
            min(cores, len(orders)),
            died,
            begin=_begin_worker,
            shared=(parts,),
            poll_s=_POLL_S,
            polled=lambda: show(sum(w * p for w, p in zip(weights, parts, strict=True)) / total),
        )
    )
    return [found[index] for index in range(len(orders))]


def _here(orders: Sequence[Order], weights: Sequence[float], show: Show) -> list[Result]:
    done, total = 0.0, math.fsum(weights)
    results = []
    for order, weight in zip(orders, weights, strict=True):
        begun = done / total

        def tick(part: float, begun: float = begun, share: float = weight / total) -> None:
            show(begun + share * part)

        results.append(compute(order, tick))
        done += weight
        show(done / total)
    return results


_shared_parts: Any = None  # of a worker: how much of each order is done


def _begin_worker(parts: Any) -> None:
    global _shared_parts
    _shared_parts = parts


def _work(index: int, order: Order) -> Result:
    def tick(part: float) -> None:
        _shared_parts[index] = part

    return compute(order, tick)
