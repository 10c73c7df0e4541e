"""Parameters that had another name: one table, read from the firmware."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tailbeat.core.law import Law, load
from tailbeat.core.param_names import (
    current_name,
    of_document,
    old_names,
    renamed,
    with_current_names,
)
from tailbeat.experiment.folder import Experiment
from tailbeat.experiment.store import Journal
from tailbeat.link.params import known_parameters


def test_the_table_is_closed() -> None:
    assert renamed() == {
        "LAW_GAIN": "ILC_GAIN",
        "LAW_KD": "ILC_KD",
        "LAW_LEAD": "ILC_LEAD",
        "LAW_TAIL": "ILC_END_EXT",
        "LAW_Q_LEN": "ILC_Q_LEN",
        "LAW_FADE": "ILC_DECR_RATE",
        "LAW_FADE_FROM": "ILC_DECR_FROM",
        "LAW_KIND": "ILC_KIND",
        "LAW_WINDOW": "ILC_WINDOW",
        "LAW_BEYOND": "ILC_EXTRAP",
        "GLIDE_S": "COAST_S",
    }
    assert set(renamed().values()) <= set(known_parameters())
    assert not set(renamed()) & set(known_parameters())


def test_names_go_both_ways() -> None:
    assert current_name("LAW_FADE") == current_name("ILC_DECR_RATE") == "ILC_DECR_RATE"
    assert current_name("AMP_MAX_RAD") == "AMP_MAX_RAD"
    assert old_names("COAST_S") == ["GLIDE_S"]
    assert old_names("AMP_MAX_RAD") == old_names("GLIDE_S") == []


def test_a_file_has_either_name() -> None:
    now = {"ILC_GAIN": 3.0, "AMP_MAX_RAD": 0.5}
    assert with_current_names({"LAW_GAIN": 3.0, "AMP_MAX_RAD": 0.5}) == now
    assert with_current_names(now) == now
    document = {"LAW_GAIN": 1, "params": {"LAW_GAIN": 3.0, "AMP_MAX_RAD": 0.5}}
    assert of_document(document) == {"LAW_GAIN": 1, "params": now}
    assert of_document({"params": None}) == {"params": None}


def test_settings_and_journal_of_an_experiment(tmp_path: Path) -> None:
    (tmp_path / "raw").mkdir()
    settings = {"fish": "A", "params": {"GLIDE_S": 0.75, "ILC_KD": 0.5}}
    (tmp_path / "settings.json").write_text(json.dumps(settings))
    experiment = Experiment(tmp_path)
    assert experiment.settings()["params"] == {"COAST_S": 0.75, "ILC_KD": 0.5}
    journal = Journal(tmp_path / "journal.jsonl")
    journal.add("set", params={"LAW_BEYOND": 2.0})
    assert journal.entries("set")[0]["params"] == {"ILC_EXTRAP": 2.0}


@pytest.mark.parametrize("names", [("LAW_GAIN", "LAW_TAIL"), ("ILC_GAIN", "ILC_END_EXT")])
def test_a_law_has_either_name(names: tuple[str, str], tmp_path: Path) -> None:
    path = tmp_path / "law.json"
    path.write_text(json.dumps({names[0]: 3.0, names[1]: 2}))
    assert load(path) == Law(kp_rad_s_m=3.0, tail=2)
