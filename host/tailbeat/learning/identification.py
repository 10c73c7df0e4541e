"""What is known of one fish: its model, models as likely, how its swims scatter. A JSON file."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError, reason
from tailbeat.core.files import replace_file
from tailbeat.learning.fish_model import FishModel, Swim
from tailbeat.learning.fit import Fit, Scatter

_FORMAT = "tailbeat identified 1"


@dataclass(frozen=True)
class Identified:
    """``models``: the bootstrap's, at least one. ``covariance``: 4 x 4 as in Fit. ``scatter``: how
    swims differ. ``assumed``: names of ``FishModel`` fields that no data spoke of (a table of
    steady speeds tells nothing of kappa and delay). ``source``: ``table``, ``runs`` or ``trials``.
    ``alpha_kg_m``: the thesis's drag coefficient by (8.5)-(8.13) where steady speeds are known."""

    model: FishModel
    models: list[FishModel]
    covariance: F64
    scatter: Scatter = field(default_factory=Scatter)
    source: str = "runs"
    assumed: tuple[str, ...] = ()
    unique_id: str = ""
    made: str = ""
    alpha_kg_m: float | None = None
    swims: list[Swim] = field(default_factory=list)

    @property
    def band(self) -> dict[str, tuple[float, float]]:
        """95 % interval of every field of the model, from the bootstrap."""
        rows = {name: [getattr(m, name) for m in self.models] for name in vars(self.model)}
        low_high = {n: np.percentile(values, [2.5, 97.5]) for n, values in rows.items()}
        return {name: (float(low), float(high)) for name, (low, high) in low_high.items()}

    @classmethod
    def of(
        cls,
        found: Fit,
        models: list[FishModel],
        swims: list[Swim],
        source: str = "runs",
        unique_id: str = "",
        scatter: Scatter | None = None,
    ) -> Identified:
        """From a fit of ``swims`` and models as likely (fitting.bootstrap or fitting.sample)."""
        return cls(
            model=found.model,
            models=models or [found.model],
            covariance=found.covariance,
            scatter=scatter or Scatter(),
            source=source,
            unique_id=unique_id,
            made=datetime.now().astimezone().isoformat(timespec="seconds"),
            swims=swims,
        )

    def as_dict(self) -> dict[str, Any]:
        """What the file holds: JSON types, SI units; NaN as null."""
        return {
            "format": _FORMAT,
            "unique_id": self.unique_id,
            "made": self.made,
            "source": self.source,
            "assumed": list(self.assumed),
            "alpha_kg_m": self.alpha_kg_m,
            "model": asdict(self.model),
            "band": {name: list(band) for name, band in self.band.items()},
            "covariance": self.covariance.tolist(),
            "scatter": asdict(self.scatter),
            "models": [list(asdict(model).values()) for model in self.models],
            "swims": [_swim_document(swim) for swim in self.swims],
        }

    def save(self, path: Path) -> None:
        """Writes the file whole or not at all, and so that it lasts."""
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(path, json.dumps(self.as_dict(), indent=1, allow_nan=False) + "\n")

    @classmethod
    def from_dict(cls, raw: dict[str, Any]) -> Identified:
        """Of what ``as_dict`` gave. Raises KeyError, TypeError, ValueError or AttributeError."""
        return _from_document(raw)

    @classmethod
    def load(cls, path: Path) -> Identified:
        """Raises InputError when it is not there or damaged."""
        remedy = "Identify the fish: tailbeat session identify --out FILE"
        try:
            raw = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise InputError(f"cannot read {path} ({reason(error)}).", remedy) from error
        try:
            return _from_document(raw)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise InputError(f"{path} does not hold an identified fish.", remedy) from error


def _swim_document(swim: Swim) -> dict[str, Any]:
    speed = [value if math.isfinite(value) else None for value in swim.speed_m_s.tolist()]
    return asdict(swim) | {
        "amplitude_rad": swim.amplitude_rad.tolist(),
        "speed_m_s": speed,
        "sigma_m_s": swim.sigma_m_s.tolist(),
    }


def _from_document(raw: dict[str, Any]) -> Identified:
    if raw["format"] != _FORMAT:
        raise ValueError(raw["format"])
    model = FishModel(**raw["model"])
    covariance = np.array(raw["covariance"], dtype=np.float64)
    models = [FishModel(*map(float, row)) for row in raw["models"]]
    numbers = [*covariance.ravel(), *(v for m in (model, *models) for v in asdict(m).values())]
    if covariance.shape != (4, 4) or not models or not all(map(math.isfinite, numbers)):
        raise ValueError("numbers")
    return Identified(
        model=model,
        models=models,
        covariance=covariance,
        scatter=Scatter(**raw["scatter"]),
        source=str(raw["source"]),
        assumed=tuple(map(str, raw["assumed"])),
        unique_id=str(raw["unique_id"]),
        made=str(raw["made"]),
        alpha_kg_m=raw["alpha_kg_m"],
        swims=[_swim_from(swim) for swim in raw["swims"]],
    )


def _swim_from(raw: dict[str, Any]) -> Swim:
    arrays = {
        name: np.array(raw[name], dtype=np.float64)  # None becomes NaN
        for name in ("amplitude_rad", "speed_m_s", "sigma_m_s")
    }
    return Swim(**(raw | arrays))
