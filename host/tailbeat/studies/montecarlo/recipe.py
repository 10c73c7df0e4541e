"""Recipes: which fish learn with which laws in which noise, and what that is to show. TOML files.

A recipe is the product of its ``[[plant]]``, ``[[law]]``, ``[[noise]]`` and corners, each for
``seeds`` seeds. ``[[claim]]`` says in figures what the result must hold to (``claims``).
docs/monte-carlo.md lists every key.
"""

from __future__ import annotations

import hashlib
import json
import math
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from importlib.resources import files
from itertools import product
from pathlib import Path
from typing import Any

from tailbeat.core.errors import InputError, reason
from tailbeat.core.native import lib
from tailbeat.core.reference import from_text
from tailbeat.sim.config import PLANTS, config_field, make_config
from tailbeat.studies.montecarlo.batch import parse_lengths
from tailbeat.studies.montecarlo.results import NUMBER_COLUMNS

LAW_KINDS = ("p", "design", "model", "repeats")
WINDOW_MIN, WINDOW_MAX = 2, 8
PASTS = ("last", "mean", "window")
STATISTICS = (
    "median", "p05", "p90", "p95", "max", "min", "share", "monotone", "settled", "reach",
)  # fmt: skip
BY_REPEATS = ("monotone", "settled")  # statistics of whole runs, judged by a fixed input's
REFERENCE_IDENTIFIED = "feasible, identified"
REFERENCES_FEASIBLE = ("feasible", REFERENCE_IDENTIFIED)
_JUDGES = ("title", "claims", "description", "source")  # no result depends on them
_TABLES = ("plants", "laws", "noises", "claims", "corners", "name", "source")


@dataclass(frozen=True)
class SimSettings:
    """A plant or a noise: values of the simulator (fields of ``sim_config_t``) under a name.
    ``plant``: the simulator's plant they change; meaningless for a noise. ``lengths``: how long
    trials are (lengths.parse); of a noise only."""

    name: str
    values: dict[str, float] = field(default_factory=dict)
    plant: str = "tank"
    lengths: str = ""


@dataclass(frozen=True)
class LawSpec:
    """``kind``: ``p`` the board's law as given; ``design`` the board's law, designed from
    identification runs of each fish; ``model`` learning with the model; ``repeats`` the
    least-squares input of the simulated plant, again and again. ``gain`` and ``lead_beats`` are
    also what ``model`` falls back to. ``rollback_ratio`` 0 = the board never goes back to the best.
    ``past`` of ``p``: what it learns from: the ``last`` trial, the ``mean`` of all, or a ``window``
    of so many. ``corners``: it is identified on fish that differ from the one it learns on.
    ``cold``: leaves out what the others learn first."""

    name: str
    kind: str
    gain: float = 4.0
    lead_beats: float = 1.0  # as ILC_LEAD
    q_len: int = 1
    fade: float = 0.0
    fade_from: int = 5
    step_max_rad: float = 0.0
    rollback_ratio: float = 0.0
    past: str = "last"
    window: int = 3
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


@dataclass(frozen=True)
class ClaimSpec:
    """``statistic`` of column ``of`` (over column ``over``) in the rows of ``where`` at
    ``iteration`` (None: all from ``from_iteration`` on; -1: the last), for each plant, law, noise,
    corner and reference by itself (``pool``: all together), over the same of the rows of
    ``against``, which may have a statistic of its own; must be at least or at most that, or both.
    What is not known makes it fail. ``level``: of the statistic ``reach``."""

    text: str
    statistic: str
    of: str = "true_max_abs_error_m_s"
    over: str = ""
    where: dict[str, list[str]] = field(default_factory=dict)
    iteration: int | None = None
    from_iteration: int = 1
    against: dict[str, Any] = field(default_factory=dict)
    pool: bool = False
    level: float = 1.2
    at_most: float | None = None
    at_least: float | None = None


@dataclass(frozen=True)
class Recipe:
    """``before`` and ``before_iterations``: a reference that is learned first. ``chunk``: seeds in
    one piece of work, 0 = by the law; no number depends on it. ``source``: its TOML."""

    name: str
    title: str
    plants: list[SimSettings]
    laws: list[LawSpec]
    noises: list[SimSettings] = field(default_factory=lambda: [SimSettings("usual")])
    corners: list[Corner] = field(default_factory=list)
    claims: list[ClaimSpec] = field(default_factory=list)
    reference: str = "thesis"
    iterations: int = 6
    before: str = ""
    before_iterations: int = 0
    seeds: int = 20
    first_seed: int = 1
    chunk: int = 0
    amplitude_max_rad: float = math.pi / 4
    description: str = ""
    source: str = field(default="", repr=False)

    def with_seeds(self, seeds: int) -> Recipe:
        """The same for another number of fish."""
        if seeds < 1:
            raise InputError(f"{seeds} seeds are none.", "Give 1 or more.")
        return replace(self, seeds=seeds)

    @property
    def crc(self) -> str:
        """Names everything that results depend on; not the claims, which only judge them."""
        content = {k: v for k, v in asdict(self).items() if k not in _JUDGES}
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]


def packaged() -> dict[str, Any]:
    """The recipes that come with the package, by name."""
    folder = files("tailbeat.studies.montecarlo") / "recipes"
    found = [entry for entry in folder.iterdir() if entry.name.endswith(".toml")]
    return {entry.name[:-5]: entry for entry in sorted(found, key=lambda entry: entry.name)}


def load(text: str) -> Recipe:
    """A packaged recipe by name, or one from a TOML file by path."""
    known = packaged()
    source = known.get(text)
    name = text
    if source is None:
        path = Path(text)
        if not path.is_file():
            raise InputError(
                f"there is no recipe '{text}'.", f"Known are {', '.join(known)}, or give a file."
            )
        source, name = path, path.stem
    try:
        return parse(source.read_text(encoding="utf-8"), name)
    except OSError as error:
        raise InputError(f"cannot read {text} ({reason(error)}).", "Check the file.") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{text} is not a text file.", "Recipes are TOML in UTF-8.") from error


def parse(text: str, name: str) -> Recipe:
    """Raises InputError, one line, for whatever does not make sense."""
    try:
        raw = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"recipe {name} is not TOML ({error}).", "Correct that line.") from error
    return replace(_Parser(name).recipe(raw), source=text)


class _Parser:
    """Turns what TOML holds into a recipe; every refusal names the recipe and the place."""

    def __init__(self, name: str) -> None:
        self.name = name

    def fail(self, what: str, remedy: str) -> InputError:
        return InputError(f"recipe {self.name}: {what}.", remedy)

    def recipe(self, raw: dict[str, Any]) -> Recipe:
        lists: dict[str, tuple[str, Callable[[dict[str, Any], int], list[Any]]]] = {
            "plant": ("plants", self.plant),
            "law": ("laws", self.law),
            "noise": ("noises", self.noise),
            "claim": ("claims", self.claim),
        }
        values: dict[str, Any] = {}
        for key, (target, make) in lists.items():
            if key in raw:
                values[target] = self.each(key, raw[key], make)
        for target, key in (("plants", "plant"), ("laws", "law")):
            if not values.get(target):
                raise self.fail(f"there is no [[{key}]]", "A recipe needs at least one.")
        if "corners" in raw:
            values["corners"] = self.corners(raw["corners"])
        plain = {k: v for k, v in raw.items() if k not in lists and k != "corners"}
        taken = [f.name for f in fields(Recipe) if f.name not in _TABLES]
        values |= self.typed("the recipe", plain, Recipe, taken)
        values.setdefault("title", self.name)
        return self.checked(Recipe(name=self.name, **values))

    def each(
        self, key: str, raw: Any, make: Callable[[dict[str, Any], int], list[Any]]
    ) -> list[Any]:
        if not isinstance(raw, list) or not all(isinstance(item, dict) for item in raw):
            raise self.fail(f"'{key}' is no table", f"Write it as [[{key}]].")
        return [one for i, item in enumerate(raw) for one in make(dict(item), i)]

    def typed(
        self, where: str, raw: Mapping[str, Any], target: type, names: list[str]
    ) -> dict[str, Any]:
        kinds = {f.name: str(f.type) for f in fields(target)}
        values: dict[str, Any] = {}
        for key, value in raw.items():
            if key not in names:
                raise self.fail(f"{where}: unknown key {key}", f"Known are {', '.join(names)}.")
            values[key] = self.value(where, key, value, kinds[key])
        return values

    def value(self, where: str, key: str, value: Any, kind: str) -> Any:
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if kind.startswith("float") and number and math.isfinite(value):
            return float(value)
        if kind.startswith("int") and number and value == int(value):
            return int(value)
        if (kind == "str" and isinstance(value, str)) or (
            kind == "bool" and isinstance(value, bool)
        ):
            return value
        wanted = {"str": "a text", "bool": "true or false", "int": "a whole number"}
        word = wanted.get(kind.split(" ")[0], "a number")
        raise self.fail(f"{where}: {key} = {value!r} is not {word}", f"Give {word}.")

    def plant(self, raw: dict[str, Any], index: int) -> list[SimSettings]:
        return self.settings("plant", raw, index)

    def noise(self, raw: dict[str, Any], index: int) -> list[SimSettings]:
        if "plant" in raw:
            raise self.fail("a noise has no plant", "Put it into [[plant]].")
        return self.settings("noise", raw, index)

    def settings(self, what: str, raw: dict[str, Any], index: int) -> list[SimSettings]:
        """One, or as many as the product of the values that are given as lists."""

        plant = raw.pop("plant", "tank")
        given = raw.pop("name", None)
        label = f"{what} {given or index + 1}"
        lengths = self.lengths(label, raw.pop("lengths", "")) if what == "noise" else ""
        if plant not in PLANTS:
            raise self.fail(f"{label}: there is no plant {plant}", f"Use {', '.join(PLANTS)}.")
        choices: dict[str, list[float]] = {}
        for key, value in raw.items():
            try:
                name = config_field(key)
            except InputError as error:
                raise self.fail(f"{label}: {error.message}", error.remedy) from error
            many = value if isinstance(value, list) else [value]
            choices[name] = [self.value(label, key, one, "float") for one in many]
        varied = [name for name, many in choices.items() if len(many) > 1]
        found = []
        for values in product(*choices.values()):
            row = dict(zip(choices, values, strict=True))
            words = [f"{n.split('_')[0]} {row[n]:g}" for n in varied]
            title = " ".join([*([str(given)] if given else []), *words])
            found.append(SimSettings(title or f"{plant}", row, plant, lengths))
        return found

    def lengths(self, label: str, raw: Any) -> str:
        text = str(self.value(label, "lengths", raw, "str"))
        try:
            parse_lengths(text)
        except InputError as error:
            raise self.fail(f"{label}: {error.message.rstrip('.')}", error.remedy) from error
        return text

    def law(self, raw: dict[str, Any], index: int) -> list[LawSpec]:
        names = [f.name for f in fields(LawSpec)]
        values = self.typed(f"law {raw.get('name', index + 1)}", raw, LawSpec, names)
        kind = values.setdefault("kind", "p")
        if kind not in LAW_KINDS:
            raise self.fail(f"there is no law of kind {kind}", f"Use {', '.join(LAW_KINDS)}.")
        values.setdefault("name", kind)
        law = LawSpec(**values)
        if law.past not in PASTS or (law.past != "last" and kind != "p"):
            raise self.fail(
                f"law {law.name}: past = {law.past} is not for kind {kind}",
                f"Use kind p with one of {', '.join(PASTS)}.",
            )
        if not WINDOW_MIN <= law.window <= WINDOW_MAX:
            raise self.fail(
                f"law {law.name}: a window of {law.window} trials",
                f"Use {WINDOW_MIN} to {WINDOW_MAX}, as the board's ILC_WINDOW.",
            )
        return [law]

    def corners(self, raw: Any) -> list[Corner]:
        names = [f.name for f in fields(Corner) if f.name != "name"]
        if not isinstance(raw, dict):
            raise self.fail("'corners' is no table", "Write it as [corners].")
        choices: dict[str, list[float]] = {}
        for key, value in raw.items():
            if key not in names:
                raise self.fail(f"corners: unknown key {key}", f"Known are {', '.join(names)}.")
            many = value if isinstance(value, list) else [value]
            choices[key] = [self.value("corners", key, one, "float") for one in many]
        found = []
        for values in product(*choices.values()):
            row = dict(zip(choices, values, strict=True))
            words = [f"{key.split('_')[0]}{_signed(key, value)}" for key, value in row.items()]
            found.append(Corner(", ".join(words), **row))
        return found

    def claim(self, raw: dict[str, Any], index: int) -> list[ClaimSpec]:
        label = f"claim {index + 1}"
        names = [f.name for f in fields(ClaimSpec)]
        where, against = raw.pop("where", {}), raw.pop("against", {})
        if not isinstance(where, dict) or not isinstance(against, dict):
            raise self.fail(f"{label}: where and against are no tables", 'Write {law = "name"}.')
        values = self.typed(label, raw, ClaimSpec, names)
        for key in ("text", "statistic"):
            if key not in values:
                raise self.fail(f"{label} has no {key}", "Every claim needs one.")
        statistics = [values["statistic"], against.get("statistic", "median")]
        for unknown in (one for one in statistics if one not in STATISTICS):
            raise self.fail(
                f"{label}: there is no statistic {unknown}", f"Use {', '.join(STATISTICS)}."
            )
        if not {"at_most", "at_least"} & set(values):
            raise self.fail(f"{label} has no bound", "Give at_most, at_least or both.")
        values["where"] = self.selection(label, where)
        iteration, statistic = against.pop("iteration", None), against.pop("statistic", None)
        values["against"] = self.selection(label, against)
        if statistic is not None:
            values["against"]["statistic"] = statistic
        if iteration is not None:
            values["against"]["iteration"] = self.value(label, "iteration", iteration, "int")
        return [ClaimSpec(**values)]

    def selection(self, label: str, raw: dict[str, Any]) -> dict[str, Any]:
        known = ("plant", "law", "noise", "corner", "reference")
        for key in raw:
            if key not in known:
                raise self.fail(f"{label}: rows have no {key}", f"Use {', '.join(known)}.")
        lists = {k: v if isinstance(v, list) else [v] for k, v in raw.items()}
        return {k: [self.value(label, k, one, "str") for one in many] for k, many in lists.items()}

    def checked(self, recipe: Recipe) -> Recipe:
        for what, items in (
            ("plant", recipe.plants),
            ("law", recipe.laws),
            ("noise", recipe.noises),
        ):
            names = [item.name for item in items]
            twice = [name for name in names if names.count(name) > 1]
            if twice:
                raise self.fail(f"two of {what} are called {twice[0]}", "Give each its own name.")
        if min(recipe.seeds, recipe.iterations) < 1 or min(recipe.first_seed, recipe.chunk) < 0:
            raise self.fail("seeds and iterations must be 1 or more", "Correct them.")
        if bool(recipe.before) != (recipe.before_iterations > 0):
            raise self.fail("before needs before_iterations, and the other way", "Give both.")
        if recipe.before and any(law.kind == "repeats" and not law.cold for law in recipe.laws):
            raise self.fail("repeats cannot change the reference", "Leave before away.")
        if any(law.corners for law in recipe.laws) and not recipe.corners:
            raise self.fail("a law wants corners and there are none", "Add [corners].")
        for reference in filter(None, (recipe.reference, recipe.before)):
            self.check_reference(reference)
        for claim in recipe.claims:
            self.check_claim(recipe, claim)
        self.check_simulator(recipe)
        return recipe

    def check_reference(self, text: str) -> None:

        if text in REFERENCES_FEASIBLE:
            return
        try:
            from_text(text)
        except InputError as error:
            raise self.fail(error.message.rstrip("."), error.remedy) from error

    def check_claim(self, recipe: Recipe, claim: ClaimSpec) -> None:

        for column in filter(None, (claim.of, claim.over)):
            if column not in NUMBER_COLUMNS:
                raise self.fail(
                    f"claim '{claim.text}': there is no column {column}",
                    f"Use {', '.join(NUMBER_COLUMNS)}.",
                )
        known = {
            "plant": [p.name for p in recipe.plants],
            "law": [law.name for law in recipe.laws],
            "noise": [n.name for n in recipe.noises],
        }
        for chosen in (claim.where, claim.against):
            for key, names in known.items():
                for name in chosen.get(key, []):
                    if name not in names:
                        raise self.fail(
                            f"claim '{claim.text}': there is no {key} '{name}'",
                            f"Use {', '.join(names)}.",
                        )
        if claim.pool and claim.statistic == "reach":
            raise self.fail(f"claim '{claim.text}': reach is of one group", "Leave pool away.")
        if claim.statistic in BY_REPEATS and "law" not in claim.against:
            raise self.fail(
                f"claim '{claim.text}': {claim.statistic} needs the repeats it is judged by",
                'Add against = {law = "the repeats"}.',
            )

    def check_simulator(self, recipe: Recipe) -> None:
        """The simulator itself says whether the values make sense."""

        for plant, noise in product(recipe.plants, recipe.noises):
            config = make_config(plant.plant, recipe.first_seed, plant.values | noise.values)
            if not lib.sim_config_valid(config):
                raise self.fail(
                    f"the simulator cannot run plant '{plant.name}' with noise '{noise.name}'",
                    "Check the values: SI units.",
                )


def _signed(key: str, value: float) -> str:
    return f" {value:+g} s" if key.endswith("_s") else f" x{value:g}"
