"""The file of an identified fish."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tailbeat.core.errors import InputError
from tailbeat.learning.fish_model import FishModel, TrialSpeeds
from tailbeat.learning.identification import Identified, now_text
from tailbeat.learning.scatter import Scatter

MODEL = FishModel(10.0, 0.2126, 0.2047, 0.316)


def identified() -> Identified:
    models = [FishModel(k, 0.2126, 0.2047, 0.316) for k in np.linspace(8, 12, 41)]
    trial = TrialSpeeds(
        np.array([0.3, 0.5]), np.array([0.01, np.nan]), np.array([1e-3, 1e-3]), trial=7
    )
    covariance = np.diag([1e-2, 1e-3, 1e-4, 1e-3])
    return Identified(
        MODEL, models, covariance, Scatter(gain=0.03),
        unique_id="ab12", made=now_text(), trials=[trial],
    )  # fmt: skip


def test_what_is_saved_comes_back(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "identified.json"
    was = identified()
    was.save(path)
    again = Identified.load(path)
    assert again.as_dict() == was.as_dict()
    assert again.model == MODEL and again.models == was.models
    assert np.isnan(again.trials[0].speed_m_s[1]) and again.trials[0].trial == 7
    assert again.band["kappa_per_m"] == pytest.approx((8.1, 11.9))
    assert [p.name for p in path.parent.iterdir()] == ["identified.json"]


@pytest.mark.parametrize(
    "damage",
    [
        lambda raw: raw.update(format="tailbeat identified 9"),
        lambda raw: raw.pop("covariance"),
        lambda raw: raw["model"].update(kappa_per_m=None),
        lambda raw: raw.update(models=[]),
        lambda raw: raw.update(covariance=[[1.0]]),
        lambda raw: raw["swims"].append(3),
    ],
)
def test_a_damaged_file_is_named(tmp_path: Path, damage: object) -> None:
    path = tmp_path / "identified.json"
    identified().save(path)
    raw = json.loads(path.read_text())
    damage(raw)  # type: ignore[operator]
    path.write_text(json.dumps(raw))
    with pytest.raises(InputError, match=r"identified\.json: "):
        Identified.load(path)


def test_no_file_and_no_json_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot read"):
        Identified.load(tmp_path / "none.json")
    (tmp_path / "half.json").write_text('{"format": ')
    with pytest.raises(InputError, match=r"half\.json: no JSON"):
        Identified.load(tmp_path / "half.json")
