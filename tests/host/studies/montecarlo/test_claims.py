"""What sweeps claim: how claims are judged, and what those that come with tailbeat promise."""

from __future__ import annotations

import msgspec
import numpy as np
import pyarrow as pa
import pytest

from tailbeat.studies.montecarlo.cell import cells
from tailbeat.studies.montecarlo.recipe import ClaimSpec, load, packaged
from tailbeat.studies.montecarlo.results import DERIVED, Rows, schema
from tailbeat.studies.montecarlo.summary import judge

BOUNDS = {  # of each recipe's claims: statistic, iteration, at least, at most, for which plants
    "camera-noise": [
        ("median", -1, None, 1.15, "any"),
        ("median", -1, None, 1.1, "kappa 5, kappa 10"),
        ("median", -1, None, 1.2, "kappa 20"),
        ("p90", -1, None, 1.15, "any"),
        ("p90", -1, None, 1.25, "any"),
    ],
    "cut-trials": [
        ("p05", 5, None, 1, "any"),
        ("p05", 5, None, 1, "any"),
        ("p05", 5, None, 1, "any"),
        ("p05", 10, None, 1, "thesis, kappa 5, kappa 10, kappa 20"),
        ("p05", 10, None, 1.05, "reactive"),
        ("p05", 10, None, 1, "any"),
        ("p05", 10, None, 1, "any"),
        ("p05", 20, None, 1.05, "any"),
        ("median", 20, None, 1.3, "kappa 5, kappa 10, kappa 20"),
        ("median", 20, None, 1.35, "kappa 5, kappa 10, kappa 20"),
        ("median", 20, None, 1.02, "kappa 5, kappa 10, kappa 20"),
        ("median", 4, 1.8, None, "kappa 5, kappa 10, kappa 20"),
        ("median", 4, 1.25, None, "kappa 5, kappa 10, kappa 20"),
        ("median", 4, 1.25, None, "kappa 5, kappa 10, kappa 20"),
        ("reach", None, None, 1, "kappa 5, kappa 10, kappa 20"),
        ("reach", None, None, 1, "kappa 5, kappa 10, kappa 20"),
        ("reach", None, None, 1, "kappa 5, kappa 10, kappa 20"),
        ("min", None, 0, None, "any"),
        ("max", None, None, 0.7853983, "any"),
        ("min", None, -0.008, None, "any"),
        ("max", None, None, 0.145, "any"),
        ("max", None, None, 0.145, "any"),
        ("max", None, None, 2.64, "any"),
        ("max", None, 2.64, None, "kappa 5, kappa 10, kappa 20"),
    ],
    "cut-trials-lead": [
        ("p05", 5, None, 1.0, "kappa 5, kappa 10, kappa 20"),
        ("p05", 5, None, 1.0, "kappa 5, kappa 10, kappa 20"),
        ("p05", 5, None, 1.0, "kappa 5, kappa 10, kappa 20"),
        ("p05", 10, None, 1.0, "kappa 5, kappa 10, kappa 20"),
        ("p05", 10, None, 1.0, "kappa 5, kappa 10, kappa 20"),
        ("p05", 10, None, 1.0, "kappa 5, kappa 10, kappa 20"),
        ("p05", 20, None, 1.0, "kappa 5, kappa 10, kappa 20"),
        ("p05", 20, None, 1.0, "kappa 5, kappa 10, kappa 20"),
        ("p05", 20, None, 1.0, "kappa 5, kappa 10, kappa 20"),
        ("p05", 20, None, 1.05, "kappa 5, kappa 10, kappa 20"),
        ("p05", 20, None, 1.05, "kappa 5, kappa 10, kappa 20"),
        ("p05", 20, None, 1.05, "kappa 5, kappa 10, kappa 20"),
        ("median", 20, None, 1.1, "kappa 5, kappa 10, kappa 20"),
        ("median", 20, None, 1.1, "kappa 5, kappa 10, kappa 20"),
        ("median", 2, 1.2, None, "kappa 5, kappa 10, kappa 20"),
        ("median", 4, 1.2, None, "kappa 5, kappa 10, kappa 20"),
        ("median", 4, 1.2, None, "kappa 5, kappa 10, kappa 20"),
        ("reach", None, None, 1, "kappa 5, kappa 10, kappa 20"),
        ("reach", None, None, 1, "kappa 5, kappa 10, kappa 20"),
        ("reach", None, None, 1, "kappa 5, kappa 10, kappa 20"),
        ("reach", None, None, 7, "kappa 5, kappa 10, kappa 20"),
        ("median", 20, 1.3, None, "thesis"),
        ("min", None, 0, None, "any"),
        ("max", None, None, 0.7853983, "any"),
        ("min", None, -0.008, None, "any"),
        ("max", None, None, 0.145, "any"),
        ("max", None, None, 0.145, "any"),
        ("max", None, None, 2.64, "any"),
    ],
    "cut-trials-limits": [
        ("p05", 5, None, 1.0, "any"),
        ("p05", 5, None, 1.0, "any"),
        ("p05", 5, None, 1.0, "any"),
        ("p05", 10, None, 1.0, "any"),
        ("p05", 10, None, 1.0, "any"),
        ("p05", 10, None, 1.0, "any"),
        ("p05", 20, None, 1.0, "any"),
        ("p05", 20, None, 1.0, "any"),
        ("p05", 20, None, 1.0, "any"),
        ("min", None, 0, None, "any"),
        ("max", None, None, 0.5, "any"),
        ("max", None, None, 0.15001, "any"),
        ("min", None, -0.008, None, "any"),
        ("max", None, None, 0.085, "any"),
        ("max", None, None, 0.085, "any"),
        ("max", None, None, 2.64, "any"),
    ],
    "designed-law": [
        ("median", 6, None, 1.15, "kappa 5, kappa 10"),
        ("p90", 6, None, 1.15, "kappa 5, kappa 10"),
        ("share", None, 0.9, None, "any"),
        ("monotone", None, 0.95, None, "any"),
        ("settled", None, 0.9, None, "any"),
    ],
    "feasible": [
        ("median", 3, None, 0.006, "kappa 5, kappa 10, kappa 20, reactive"),
        ("median", 4, None, 0.005, "kappa 5, kappa 10, kappa 20, reactive"),
        ("p90", 3, None, 0.0055, "kappa 5, kappa 10, kappa 20, reactive"),
        ("p90", 2, None, 1.5, "kappa 5, kappa 10, kappa 20, reactive"),
        ("p90", 4, None, 1.2, "kappa 5, kappa 10, kappa 20, reactive"),
        ("share", None, 0.7, None, "kappa 5, kappa 10, kappa 20, reactive"),
        ("median", 2, None, 1, "reactive mild, reactive realistic"),
    ],
    "floor": [
        ("p90", 0, None, 0.1, "any"),
        ("max", 0, None, 0.2, "any"),
        ("median", 0, None, 0.25, "any"),
        ("median", 0, None, 0.42, "any"),
        ("median", 2, None, 0.25, "any"),
    ],
    "model-corners": [
        ("median", 2, None, 1.1, "any"),
        ("p90", 2, None, 1.2, "kappa 5, kappa 10, kappa 20"),
        ("p90", 2, None, 2.0, "reactive"),
    ],
    "model-law": [
        ("median", 1, None, 1.1, "any"),
        ("median", 2, None, 1.1, "any"),
        ("p90", 2, None, 1.1, "any"),
        ("share", None, 0.8, None, "any"),
    ],
    "model-structure": [
        ("median", 2, None, 1.1, "any"),
        ("p90", 2, None, 1.1, "any"),
        ("share", None, 0.8, None, "any"),
    ],
    "populations": [
        ("share", 2, 0.95, None, "reactive mild"),
        ("share", 2, 0.92, None, "reactive realistic"),
        ("share", 4, 0.75, None, "reactive hard"),
        ("share", None, None, 0.02, "any"),
        ("share", None, 0.78, None, "any"),
    ],
    "repeats": [
        ("p90", None, 1.1, None, "any"),
    ],
    "second-reference": [
        ("median", 1, None, 0.25, "kappa 10, kappa 20"),
        ("median", 1, None, 0.33, "kappa 5"),
        ("median", 1, None, 1.1, "any"),
        ("median", 1, None, 1.1, "any"),
    ],
    "thesis-law": [
        ("median", 4, 0.0184, 0.019, "kappa 10, no servo"),
        ("median", 6, 0.0148, 0.0154, "kappa 10, no servo"),
        ("median", 4, 0.0194, 0.02, "kappa 10"),
        ("median", 6, 0.0172, 0.0178, "kappa 10"),
        ("median", 6, None, 0.0198, "kappa 10, kappa 20"),
        ("median", 60, 1.1, None, "kappa 5, kappa 10, kappa 20, kappa 10, no servo"),
        ("median", 60, None, 1.2, "reactive"),
        ("settled", None, None, 0.5, "kappa 5, kappa 10, kappa 20, kappa 10, no servo"),
        ("median", 2, 0.0276, 0.0282, "kappa 10, no servo"),
        ("median", 6, 0.0113, 0.0119, "kappa 10, kappa 10, no servo"),
        ("median", 6, 0.0179, 0.0185, "kappa 5"),
        ("median", 6, 0.007, 0.0076, "kappa 20"),
        ("settled", None, 0.9, None, "any"),
    ],
}


@pytest.mark.parametrize("name", list(packaged()))
def test_packaged_recipes_are_sound_and_promise_no_less_than_they_did(name: str) -> None:
    recipe = load(name)
    assert recipe.seeds >= 20
    assert len({cell.label for cell in cells(recipe)}) == len(cells(recipe))
    assert BOUNDS[name] == [
        (
            claim.statistic, claim.iteration, claim.at_least, claim.at_most,
            ", ".join(np.atleast_1d(claim.where.get("plant", "any"))),
        )
        for claim in recipe.claims
    ]  # fmt: skip


@pytest.mark.parametrize("name", list(packaged()))
def test_p90_of_learning_is_that_of_enough_fish_against_the_same_swim(name: str) -> None:
    """A p90 of 20 fish is its second worst; repeats of other trials have other disturbances."""
    recipe = load(name)
    learning = [one for one in recipe.claims if one.statistic == "p90" and one.against]
    for claim in learning:
        assert claim.against["iteration"] == claim.iteration
        assert recipe.seeds >= 60


def _rows(**columns: object) -> Rows:
    length = max(len(np.atleast_1d(values)) for values in columns.values())
    fields = schema()
    filled = {one.name: np.full(length, "" if one.type == "string" else 0) for one in fields}
    given = {name: np.broadcast_to(values, length) for name, values in columns.items()}
    table = {one.name: pa.array((filled | given)[one.name], type=one.type) for one in fields}
    rows = Rows.of(pa.table(table))
    rows.columns.update({name: given[name] for name in DERIVED if name in given})
    return rows


def _claim(**values: object) -> ClaimSpec:
    return ClaimSpec(**{"text": "it holds", "statistic": "median", "at_most": 1.0, **values})  # type: ignore[arg-type]


def test_claims_are_judged_by_their_worst_group() -> None:
    rows = _rows(
        plant=["a"] * 5 + ["b"] * 5,
        iteration=1,
        true_max_abs_error_m_s=[1, 2, 3, 4, 100, 2, 3, 4, 5, 6],
        floor_lsq_m_s=2.0,
    )
    found = judge(_claim(over="floor_lsq_m_s", at_most=2.0), rows)
    assert (found.figure, found.group, found.holds) == (2.0, "b", True)
    assert found.figures == {"a": 1.5, "b": 2.0}
    assert not judge(_claim(over="floor_lsq_m_s", at_most=1.9), rows).holds
    between = judge(_claim(at_least=3.5, at_most=5.0), rows)
    assert (between.figure, between.group, between.holds) == (3.0, "a", False)
    assert judge(_claim(statistic="max", at_most=100), rows).figure == 100
    assert judge(_claim(statistic="p90", where={"plant": ["b"]}), rows).figure == 5.6
    assert judge(_claim(statistic="median", pool=True), rows).figure == 3.5
    assert judge(_claim(where={"plant": ["b*", "c"]}, at_most=4), rows).figures == {"b": 4.0}
    assert not judge(_claim(where={"plant": ["c*"]}), rows).holds


def test_what_more_fish_would_decide_is_open() -> None:
    values = np.linspace(0.8, 1.2, 21)
    rows = _rows(iteration=1, seed=range(21), true_max_abs_error_m_s=values)
    near, far = judge(_claim(at_most=0.99), rows), judge(_claim(at_most=0.5), rows)
    assert (near.holds, near.is_open, far.holds, far.is_open) == (False, True, False, False)
    assert near.interval[0] < 0.99 < near.figure < near.interval[1]
    assert not judge(_claim(at_most=1.1), rows).is_open, "it holds"


def test_claims_against_others() -> None:
    rows = _rows(
        law=["x", "x", "y", "y"] * 2,
        iteration=[1, 2] * 4,
        seed=[1, 1, 1, 1, 2, 2, 2, 2],
        true_max_abs_error_m_s=[8, 4, 2, 2, 8, 4, 2, 2],
    )
    where = {"law": ["x"]}
    assert judge(_claim(where=where, iteration=2, against={"iteration": 1}), rows).figure == 0.5
    assert judge(_claim(where=where, iteration=-1, against={"law": ["y"]}), rows).figure == 2.0


def test_share_needs_to_know_everything() -> None:
    rows = _rows(iteration=[1, 1, 2, 2, 2, 2], ratio_inside=[np.nan, np.nan, 1, 0, 1, 1])
    claim = _claim(statistic="share", of="ratio_inside", at_most=None, at_least=0.7)
    assert judge(msgspec.structs.replace(claim, from_iteration=2), rows).figure == 0.75
    found = judge(claim, rows)
    assert np.isnan(found.figure)
    assert not found.holds


def test_predictions_are_judged_by_what_was_measured() -> None:
    rows = _rows(
        iteration=2,
        max_abs_error_m_s=[1.0, 2.0, 3.0, np.nan],
        true_max_abs_error_m_s=9.0,
        predicted_low_m_s=1.5,
        floor_lsq_m_s=1.0,
        predicted_high_m_s=[2.5, 2.5, 2.5, 2.5],
    )
    assert np.array_equal(rows.columns["prediction_inside"], [0, 1, 0, np.nan], equal_nan=True)


def test_settled_is_judged_by_the_end_of_repeats() -> None:
    """Trials 8 to 10 over trials 5 to 7: one run doubles, one halves; repeats do not change."""
    begin = [9, 9, 9, 9, 9]
    runs = [[4] * 3 + [8] * 3, [4] * 3 + [2] * 3, [4, 5, 6, 6, 5, 4], [4] * 6]
    grid = np.array([begin + run for run in runs], dtype=float)
    rows = _rows(
        law=["x"] * 22 + ["repeats"] * 22,
        seed=np.repeat([1, 2, 1, 2], 11),
        iteration=list(range(11)) * 4,
        max_abs_error_m_s=grid.ravel(),
    )
    claim = _claim(
        statistic="settled", of="max_abs_error_m_s", where={"law": ["x"]},
        against={"law": ["repeats"]}, at_most=None, at_least=0.6,
    )  # fmt: skip
    assert judge(claim, rows).figure == 0.5
    assert np.isnan(judge(claim, rows.where(rows.columns["iteration"] < 10)).figure)
    lost = grid.ravel()
    lost[8] = np.nan
    rows.columns["max_abs_error_m_s"] = lost
    assert np.isnan(judge(claim, rows).figure)


def test_monotone_is_judged_by_the_largest_rise_of_repeats() -> None:
    """Repeats rise by 1.1 at most; of two runs one rises by 1.05 over its best, one by 1.2."""
    runs = [[4, 2, 2.1], [4, 2, 2.4], [1, 1.1, 1.0], [1, 1.1, 1.0]]
    rows = _rows(
        law=["x"] * 8 + ["repeats"] * 8,
        seed=np.repeat([1, 2, 1, 2], 4),
        iteration=[0, 1, 2, 3] * 4,
        max_abs_error_m_s=np.array([[9, *run] for run in runs]).ravel(),
    )
    claim = _claim(
        statistic="monotone", of="max_abs_error_m_s", where={"law": ["x"]},
        against={"law": ["repeats"]}, at_most=None, at_least=0.6,
    )  # fmt: skip
    found = judge(claim, rows)
    assert (found.figure, found.holds) == (0.5, False)
