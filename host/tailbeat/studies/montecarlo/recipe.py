"""Recipes: which fish learn with which laws in which noise, and what that is to show. TOML files.

A recipe is the product of its ``[[plant]]``, ``[[law]]``, ``[[noise]]`` and corners, each for
``seeds`` seeds. ``[[claim]]`` says in figures what the result must hold to (``claims``).
docs/how-to/monte-carlo.md lists every key.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable
from dataclasses import dataclass, field, fields, replace
from importlib.resources import files
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from tailbeat.core.decode import StrictTable, decode
from tailbeat.core.errors import InputError, did_you_mean, reason
from tailbeat.core.law import PAST_KINDS
from tailbeat.core.native import lib
from tailbeat.core.reference import from_text
from tailbeat.sim.config import PLANTS, config_field, make_config
from tailbeat.studies.montecarlo.batch import foreign_plant
from tailbeat.studies.montecarlo.populations import POPULATIONS, draw
from tailbeat.studies.montecarlo.results import NUMBER_COLUMNS

LAW_KINDS = ("p", "design", "model", "repeats")
WINDOW_MIN, WINDOW_MAX = 2, 8
STATISTICS = (
    "median", "p05", "p90", "p95", "max", "min", "share", "monotone", "settled", "reach",
)  # fmt: skip
BY_REPEATS = ("monotone", "settled")  # statistics of whole runs, judged by a fixed input's
REFERENCE_IDENTIFIED = "feasible, identified"
REFERENCES_FEASIBLE = ("feasible", REFERENCE_IDENTIFIED)
AGAINST_KEYS = ("iteration", "statistic", "of")  # the others choose rows
_SELECTORS = ("plant", "law", "noise", "corner", "reference")
_JUDGES = ("title", "claims", "description", "source")  # no result depends on them
_REMEDY = "Correct it: 'Run a Monte Carlo study' in the documentation lists every key."
_LENGTHS_REMEDY = (
    "Write it like uniform:20,50 (beats) or uniform:44,58,50 (of 50 for a full trial)."
)


@dataclass(frozen=True)
class Lengths:
    """The trial would end after a time drawn evenly from ``low`` to ``high``; ``full`` of the same
    unit last as long as the reference, 0 = as many as it has beats."""

    low: float
    high: float
    full: float = 0.0

    def executed(self, seed: int, trial: int, beats: int) -> int:
        """Whole beats that trial ``trial`` (1 = the first) has of ``beats``."""
        digest = hashlib.sha256(f"length {seed} {trial}".encode()).digest()
        drawn = (int.from_bytes(digest[:8], "little") >> 11) * 2.0**-53  # [0, 1), to 53 bits
        time = self.low + drawn * (self.high - self.low)
        return min(beats, math.floor(time * beats / (self.full or beats)))


def parse_lengths(text: str) -> Lengths | None:
    """``""``: every trial is full (None). ``uniform:LOW,HIGH`` in beats, ``uniform:LOW,HIGH,FULL``
    where FULL is a full trial. Raises InputError for anything else."""
    if not text:
        return None
    kind, _, arguments = text.partition(":")
    try:
        values = [float(part) for part in arguments.split(",")]
    except ValueError:
        values = []
    if kind != "uniform" or len(values) not in (2, 3) or not all(map(math.isfinite, values)):
        raise InputError(f"'{text}' is no length of trials.", _LENGTHS_REMEDY)
    found = Lengths(*values)
    if not 0 <= found.low <= found.high or (len(values) == 3 and found.full <= 0):
        raise InputError(f"no trial is as long as '{text}'.", _LENGTHS_REMEDY)
    return found


@dataclass(frozen=True)
class SimSettings:
    """A plant or a noise: values of the simulator (fields of ``sim_config_t``) under a name.
    ``plant``: the simulator's plant they change; meaningless for a noise. ``lengths``: how long
    trials are (``parse_lengths``); of a noise only. ``population``: that each fish is drawn from
    (``POPULATIONS``), "" = all are as ``values`` say; of a plant only. ``code``: checksum of a
    plant compiled elsewhere, whose path ``plant`` is then."""

    name: str
    values: dict[str, float] = field(default_factory=dict)
    plant: str = "tank"
    lengths: str = ""
    population: str = ""
    code: str = ""

    @property
    def each_its_own(self) -> bool:
        """Whether every fish is another one, with an error bound of its own."""
        return bool(self.population or self.code)

    def executed(self, seeds: Iterable[int], trial: int, beats: int) -> NDArray[np.int64]:
        """Whole beats that each fish swims of ``beats`` in its trial ``trial``."""
        spread = parse_lengths(self.lengths)
        return np.array([spread.executed(s, trial, beats) if spread else beats for s in seeds])


class LawSpec(StrictTable, kw_only=True):
    """``kind``: ``p`` the board's law as given; ``design`` the board's law, designed from
    identification runs of each fish; ``model`` learning with the model; ``repeats`` the
    least-squares input of the simulated plant, again and again. ``gain`` and ``lead_beats`` are
    also what ``model`` falls back to. ``rollback_ratio`` 0 = the board never goes back to the best.
    ``past`` of ``p``: what it learns from: the ``last`` trial, the ``mean`` of all, or a ``window``
    of so many. ``corners``: it is identified on fish that differ from the one it learns on.
    ``cold``: leaves out what the others learn first. Without a name it has that of its kind."""

    name: str = ""
    kind: str = "p"
    gain: float = 4.0
    lead_beats: float = 1.0  # as ILC_LEAD
    q_len: int = 1
    fade: float = 0.0
    fade_from: int = 5
    step_max_rad: float = 0.0
    rollback_ratio: float = 0.0
    past: str = "last"
    window: Annotated[int, msgspec.Meta(ge=WINDOW_MIN, le=WINDOW_MAX)] = 3  # as ILC_WINDOW
    corners: bool = False
    cold: bool = False


@dataclass(frozen=True)
class Corner:
    """How the fish that is identified differs from the one that learns."""

    name: str = ""
    kappa_factor: float = 1.0
    slope_factor: float = 1.0
    dead_zone_factor: float = 1.0
    delay_add_s: float = 0.0


class ClaimSpec(StrictTable, kw_only=True):
    """``statistic`` of column ``of`` (over column ``over``) in the rows of ``where`` at
    ``iteration`` (None: all from ``from_iteration`` on; -1: the last), for each plant, law, noise,
    corner and reference by itself (``pool``: all together), over the same of the rows of
    ``against``, which may have a statistic and a column of its own; must be at least or at most
    that, or both. What is not known makes it fail. ``level``: of the statistic ``reach``."""

    text: str
    statistic: str
    of: str = "true_max_abs_error_m_s"
    over: str = ""
    where: dict[str, str | list[str]] = msgspec.field(default_factory=dict)
    iteration: int | None = None
    from_iteration: int = 1
    against: dict[str, Any] = msgspec.field(default_factory=dict)
    pool: bool = False
    level: float = 1.2
    at_most: float | None = None
    at_least: float | None = None


class _Learning(StrictTable, kw_only=True):
    """``before`` and ``before_iterations``: a reference that is learned first. ``chunk``: seeds in
    one piece of work, 0 = by the law; no number depends on it."""

    title: str = ""
    reference: str = "thesis"
    iterations: Annotated[int, msgspec.Meta(ge=1)] = 6
    before: str = ""
    before_iterations: int = 0
    seeds: Annotated[int, msgspec.Meta(ge=1)] = 20
    first_seed: Annotated[int, msgspec.Meta(ge=0)] = 1
    chunk: Annotated[int, msgspec.Meta(ge=0)] = 0
    amplitude_max_rad: float = math.pi / 4
    description: str = ""


class _RecipeFile(_Learning, kw_only=True):
    """The TOML file: settings that are lists stand for all of their values."""

    plant: list[dict[str, Any]] = msgspec.field(default_factory=list)
    law: list[LawSpec] = msgspec.field(default_factory=list)
    noise: list[dict[str, Any]] = msgspec.field(default_factory=lambda: [{"name": "usual"}])
    claim: list[ClaimSpec] = msgspec.field(default_factory=list)
    corners: dict[str, Any] = msgspec.field(default_factory=dict)


class Recipe(_Learning, kw_only=True):
    """What a file stands for. ``source``: its TOML."""

    name: str
    plants: list[SimSettings]
    laws: list[LawSpec]
    noises: list[SimSettings]
    corners: list[Corner]
    claims: list[ClaimSpec]
    source: str

    def with_seeds(self, seeds: int) -> Recipe:
        """The same for another number of fish."""
        if seeds < 1:
            raise InputError(f"{seeds} seeds are none.", "Give 1 or more.")
        return msgspec.structs.replace(self, seeds=seeds)

    def with_first_seed(self, seed: int) -> Recipe:
        """The same with other fish."""
        return msgspec.structs.replace(self, first_seed=seed)

    def with_plant(self, path: Path) -> Recipe:
        """The same on a plant compiled elsewhere, without what is only of the simulator's. Raises
        InputError when it is none."""
        foreign_plant(str(path))
        code = hashlib.sha256(path.read_bytes()).hexdigest()[:16]
        plant = SimSettings(path.stem, {}, str(path.resolve()), code=code)
        noises = [SimSettings(one.name, {}, lengths=one.lengths) for one in self.noises[:1]]
        return msgspec.structs.replace(
            self, name=f"{self.name}-{path.stem}", plants=[plant], noises=noises, corners=[],
            claims=[], laws=[msgspec.structs.replace(law, corners=False) for law in self.laws],
        )  # fmt: skip

    @property
    def crc(self) -> str:
        """Names everything that results depend on; not the claims, which only judge them."""
        content = {k: v for k, v in msgspec.to_builtins(self).items() if k not in _JUDGES}
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]


def packaged() -> dict[str, Any]:
    """The recipes that come with the package, by name."""
    folder = files("tailbeat.studies.montecarlo") / "recipes"
    found = [entry for entry in folder.iterdir() if entry.name.endswith(".toml")]
    return {entry.name[:-5]: entry for entry in sorted(found, key=lambda entry: entry.name)}


def load(text: str) -> Recipe:
    """A packaged recipe by name, or one from a TOML file by path."""
    known = packaged()
    source, name = known.get(text) or Path(text), Path(text).stem
    if not source.is_file():
        raise InputError(
            f"there is no recipe '{text}'.",
            f"{did_you_mean(text, known)}Known are {', '.join(known)}, or give a file.",
        )
    try:
        return parse(source.read_text(encoding="utf-8"), text if text in known else name)
    except OSError as error:
        raise InputError(f"cannot read {text} ({reason(error)}).", "Check the file.") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{text} is not a text file.", "Recipes are TOML in UTF-8.") from error


def parse(text: str, name: str) -> Recipe:
    """Raises InputError, one line, for whatever does not make sense."""
    raw = decode(text, _RecipeFile, f"recipe {name}", _REMEDY, prepare=_finite, toml=True)
    reader = _Reader(name)
    plain = {key: getattr(raw, key) for key in _Learning.__struct_fields__}
    recipe = Recipe(
        **plain | {"title": raw.title or name},
        name=name,
        plants=[one for i, row in enumerate(raw.plant, 1) for one in reader.plant(row, i)],
        laws=[msgspec.structs.replace(law, name=law.name or law.kind) for law in raw.law],
        noises=[one for i, row in enumerate(raw.noise, 1) for one in reader.noise(row, i)],
        corners=reader.corners(raw.corners),
        claims=raw.claim,
        source=text,
    )
    reader.check(recipe)
    return recipe


def _finite(value: Any, key: str = "") -> Any:
    """The document. Raises ValueError when a number of it is none."""
    inside = value.items() if isinstance(value, dict) else enumerate(value)
    for name, one in inside:
        if isinstance(one, dict | list):
            _finite(one, f"{name}")
        elif isinstance(one, float) and not math.isfinite(one):
            raise ValueError(f"{name if isinstance(name, str) else key} = {one} is not a number")
    return value


class _Reader:
    """What a recipe's settings stand for; every refusal names the recipe and the place."""

    def __init__(self, name: str) -> None:
        self.name = name

    def fail(self, what: str, remedy: str) -> InputError:
        return InputError(f"recipe {self.name}: {what}.", remedy)

    def of(self, where: str, what: str, value: str, known: Iterable[str]) -> None:
        """Raises InputError unless ``value`` is known."""
        if value not in (known := tuple(known)):
            where = f"{where}: " if where else ""
            raise self.fail(f"{where}there is no {what} {value}", f"Use {', '.join(known)}.")

    def wrapped(self, where: str, error: InputError) -> InputError:
        return self.fail(f"{where}{error.message.rstrip('.')}", error.remedy)

    def choices(self, label: str, raw: dict[str, Any]) -> list[dict[str, float]]:
        """All combinations of the values that are given as lists."""
        for key, value in raw.items():
            for one in value if isinstance(value, list) else [value]:
                if isinstance(one, bool) or not isinstance(one, int | float):
                    raise self.fail(f"{label}: {key} = {one!r} is not a number", "Give a number.")
        many = [value if isinstance(value, list) else [value] for value in raw.values()]
        return [dict(zip(raw, map(float, one), strict=True)) for one in product(*many)]

    def noise(self, raw: dict[str, Any], index: int) -> list[SimSettings]:
        if "plant" in raw:
            raise self.fail("a noise has no plant", "Put it into [[plant]].")
        label = f"noise {raw.get('name', index)}"
        lengths = str(raw.get("lengths", ""))
        try:
            parse_lengths(lengths)
        except InputError as error:
            raise self.wrapped(f"{label}: ", error) from error
        settings = {key: value for key, value in raw.items() if key != "lengths"}
        return self.settings(label, settings, lengths)

    def plant(self, raw: dict[str, Any], index: int) -> list[SimSettings]:
        label, population = f"plant {raw.get('name', index)}", str(raw.get("population", ""))
        if population:
            self.of(label, "population", population, POPULATIONS)
        settings = {key: value for key, value in raw.items() if key != "population"}
        if population and "name" not in settings:
            settings["name"] = f"{settings.get('plant', 'tank')} {population}"
        return [replace(one, population=population) for one in self.settings(label, settings)]

    def settings(self, label: str, raw: dict[str, Any], lengths: str = "") -> list[SimSettings]:
        """One, or as many as the product of the values that are given as lists."""
        given, plant = str(raw.get("name", "")), str(raw.get("plant", "tank"))
        self.of(label, "plant", plant, PLANTS)
        try:
            values = {config_field(k): v for k, v in raw.items() if k not in ("name", "plant")}
        except InputError as error:
            raise self.wrapped(f"{label}: ", error) from error
        varied = [key for key, value in values.items() if isinstance(value, list) and value[1:]]
        found = []
        for row in self.choices(label, values):
            words = [given, *(f"{key.split('_')[0]} {row[key]:g}" for key in varied)]
            found.append(SimSettings(" ".join(filter(None, words)) or plant, row, plant, lengths))
        return found

    def corners(self, raw: dict[str, Any]) -> list[Corner]:
        for key in raw:
            self.of("corners", "key", key, (f.name for f in fields(Corner) if f.name != "name"))
        found = []
        for row in self.choices("corners", raw) if raw else []:
            words = [f"{key.split('_')[0]}{_signed(key, value)}" for key, value in row.items()]
            found.append(Corner(", ".join(words), **row))
        return found

    def check(self, recipe: Recipe) -> None:
        named: dict[str, list[Any]] = {
            "plant": recipe.plants,
            "law": recipe.laws,
            "noise": recipe.noises,
        }
        names = {what: [one.name for one in many] for what, many in named.items()}
        for what, known in names.items():
            if not known:
                raise self.fail(f"there is no [[{what}]]", "A recipe needs at least one.")
            if twice := [name for name in known if known.count(name) > 1]:
                raise self.fail(f"two of {what} are called {twice[0]}", "Give each its own name.")
        if bool(recipe.before) != (recipe.before_iterations > 0):
            raise self.fail("before needs before_iterations, and the other way", "Give both.")
        for law in recipe.laws:
            self.check_law(recipe, law)
        for reference in filter(None, (recipe.reference, recipe.before)):
            if reference not in REFERENCES_FEASIBLE:
                try:
                    from_text(reference)
                except InputError as error:
                    raise self.wrapped("", error) from error
        for index, claim in enumerate(recipe.claims, 1):
            self.check_claim(f"claim {index}", claim, names)
            self.check_iterations(f"claim {index}", claim, recipe)
        self.check_simulator(recipe)

    def check_law(self, recipe: Recipe, law: LawSpec) -> None:
        self.of("", "law of kind", law.kind, LAW_KINDS)
        if law.past not in PAST_KINDS or (law.past != "last" and law.kind != "p"):
            raise self.fail(
                f"law {law.name}: past = {law.past} is not for kind {law.kind}",
                f"Use kind p with one of {', '.join(PAST_KINDS)}.",
            )
        if recipe.before and law.kind == "repeats" and not law.cold:
            raise self.fail("repeats cannot change the reference", "Leave before away.")
        if law.corners and not recipe.corners:
            raise self.fail("a law wants corners and there are none", "Add [corners].")

    def check_claim(self, label: str, claim: ClaimSpec, names: dict[str, list[str]]) -> None:
        label = f"{label}, '{claim.text}'"
        self.of(label, "statistic", claim.statistic, STATISTICS)
        self.of(label, "statistic", str(claim.against.get("statistic", "median")), STATISTICS)
        if claim.at_most is None and claim.at_least is None:
            raise self.fail(f"{label} has no bound", "Give at_most, at_least or both.")
        for column in filter(None, (claim.of, claim.over, claim.against.get("of"))):
            self.of(label, "column", column, NUMBER_COLUMNS)
        rows = {k: v for k, v in claim.against.items() if k not in AGAINST_KEYS}
        for key, chosen in (*claim.where.items(), *rows.items()):
            self.of(label, "column of rows", key, _SELECTORS)
            for name in chosen if isinstance(chosen, list) else [str(chosen)]:
                self.of(label, key, name, names.get(key, [name]))
        if claim.pool and claim.statistic == "reach":
            raise self.fail(f"{label}: reach is of one group", "Leave pool away.")
        if claim.statistic in BY_REPEATS and "law" not in claim.against:
            raise self.fail(
                f"{label}: {claim.statistic} needs the repeats it is judged by",
                'Add against = {law = "the repeats"}.',
            )

    def check_iterations(self, label: str, claim: ClaimSpec, recipe: Recipe) -> None:
        most = max(recipe.iterations, recipe.before_iterations)
        for wanted in (claim.iteration, claim.from_iteration, claim.against.get("iteration")):
            if isinstance(wanted, int) and not -1 <= wanted <= most:
                raise self.fail(
                    f"{label}, '{claim.text}': there is no iteration {wanted}",
                    f"Give one of 0 to {most}, or -1 for the last.",
                )

    def check_simulator(self, recipe: Recipe) -> None:
        """The simulator itself says whether the values make sense."""
        for plant, noise in product(recipe.plants, recipe.noises):
            drawn = (
                draw(plant.population, plant.plant, recipe.first_seed) if plant.population else {}
            )
            values = drawn | plant.values | noise.values
            config = make_config(plant.plant, recipe.first_seed, values)
            if not lib.sim_config_valid(config):
                raise self.fail(
                    f"the simulator cannot run plant '{plant.name}' with noise '{noise.name}'",
                    "Check the values: SI units.",
                )


def _signed(key: str, value: float) -> str:
    return f" {value:+g} s" if key.endswith("_s") else f" x{value:g}"
