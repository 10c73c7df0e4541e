"""Trials cut short at random: what a fish then learns, in sweeps and on the board, bit for bit."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pytest

from tailbeat.board.fish import Fish
from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError
from tailbeat.core.law import Law
from tailbeat.core.reference import from_text
from tailbeat.link.messages import BeatEvent
from tailbeat.session.outcome import StopKind, StopReason
from tailbeat.session.trial import run_trial
from tailbeat.studies.montecarlo import learners
from tailbeat.studies.montecarlo.batch import BatchTrials, FishBatch
from tailbeat.studies.montecarlo.cell import cells, run_cell
from tailbeat.studies.montecarlo.recipe import ClaimSpec, SimSettings, load, parse, parse_lengths
from tailbeat.studies.montecarlo.results import Rows
from tailbeat.studies.montecarlo.summary import judge, summarise


class PastKind(NamedTuple):
    """What the board's law learns from: a key of ``PAST_KINDS``, and its window."""

    kind: str
    window: int = 3


Array = F64

UPLOAD = 1  # SPD_SOURCE
KINDS = {"last": 0, "mean": 1, "window": 2}  # ILC_KIND


class CutAfter:
    """Aborts a trial when so many beats have been told."""

    def __init__(self, beats: int) -> None:
        self.beats = beats

    def __call__(self, event: object) -> StopReason | None:
        cut = isinstance(event, BeatEvent) and event.beat + 1 >= self.beats
        return StopReason(StopKind.CALLER, "cut") if cut else None


@pytest.mark.parametrize(
    ("past", "params"),
    [
        (PastKind("last"), {}),
        (PastKind("mean"), {}),
        (PastKind("window", 3), {"ILC_LEAD": 1}),
        (PastKind("window", 5), {"ILC_DECR_RATE": 1, "ILC_DECR_FROM": 1, "DU_MAX_RAD": 0.05}),
        (PastKind("mean"), {"ILC_GAIN": 9, "ROLLBACK_RATIO": 1.01, "ILC_Q_LEN": 2}),
    ],
    ids=["last", "mean", "window 3", "window 5 with limits", "mean that rolls back"],
)
def test_a_series_of_cut_trials_on_the_board(past: PastKind, params: dict[str, float]) -> None:
    """The board of the simulator, its store and its link, against the batch of a sweep: the same
    amplitudes to the last bit, trial after trial."""
    reference = from_text("cosine:0.07,4,2")
    base = {"ILC_KIND": KINDS[past.kind], "ILC_WINDOW": past.window, "ROLLBACK_RATIO": 0}
    one_fish = FishBatch("tank", [{"seed": 5}])
    noise = SimSettings("cut", lengths="uniform:4,13")
    rolled, ends = [], []
    with Fish.connect("sim:tank", seed=5) as fish:
        values = {"SPD_SOURCE": UPLOAD, "AMP_MAX_RAD": 0.785, "DU_MAX_RAD": 0, **base, **params}
        for name, value in values.items():
            fish.params.set(name, value)
        known = fish.params.values()
        law, ratio = Law.from_params(known, reference.beat_s), known["ROLLBACK_RATIO"]
        batch = learners.BoardLaw([law], ratio, *past)
        batch.begin(reference)
        fish.upload_reference(reference)
        for number in range(1, 10):
            amplitude = batch.following()
            wanted = noise.executed([5], number, reference.beats)
            outcome = run_trial(fish, guard=CutAfter(int(wanted[0])))
            told = {beat.beat: beat.amplitude_rad for beat in outcome.beats}
            assert all(np.float32(told[k]) == np.float32(amplitude[0, k]) for k in told)
            executed = np.array([outcome.executed_beats])
            ends.append(outcome.executed_beats)
            trials = one_fish.run(amplitude, number, reference.beat_s).cut(executed)
            if outcome.end != "complete":
                fish.clear()
            fish.upload_speeds(number, trials.speed_m_s[0], np.full(reference.beats, 1e-3))
            fish.learn()
            rolled.append(batch.learn(trials)["verdict"])
            stored = np.clip(fish.amplitudes().values, 0, np.float32(law.amplitude_max_rad))
            assert np.array_equal(stored, batch.following()[0].astype(np.float32)), number
    assert any("rolled_back" in one for one in rolled) == (ratio > 0)
    assert min(ends) < reference.beats == max(ends)


def by_hand(past: PastKind, gain: float, speed: Array, wanted: Array) -> list[Array]:
    """The amplitudes of all trials by the formulas, in double, saturated to [0, 0.6]."""
    recorded, errors = [np.clip(gain * wanted, 0, 0.6)], []
    for i, trial in enumerate(speed, start=1):
        errors.append(np.where(np.isnan(trial), 0.0, wanted - trial))
        if past.kind == "mean":
            following = np.mean(recorded, axis=0) + (i + 1) * gain * np.mean(errors, axis=0)
        else:
            last = past.window if past.kind == "window" else 1
            following = np.mean(recorded[-last:], axis=0) + gain * np.mean(errors[-last:], axis=0)
        recorded.append(np.clip(following, 0, 0.6))
    return recorded


@pytest.mark.parametrize(
    "past", [PastKind("last"), PastKind("mean"), PastKind("window", 2), PastKind("window", 5)]
)
def test_averages_are_what_the_formulas_say(past: PastKind) -> None:
    """(2.10) and the moving average, with cut trials and saturation, by numpy."""
    rng = np.random.default_rng(3)
    reference = from_text("cosine:0.07,4,2")
    wanted = reference.speed_m_s.astype(np.float64)
    speed = wanted + rng.normal(0, 0.02, (9, reference.beats))
    for row, cut in zip(speed, rng.integers(3, reference.beats + 1, len(speed)), strict=True):
        row[cut:] = np.nan
    board = learners.BoardLaw([Law(kp_rad_s_m=5.0, amplitude_max_rad=0.6)], 0.0, *past)
    board.begin(reference)
    for trial, expected in zip(speed, by_hand(past, 5.0, speed, wanted), strict=False):
        np.testing.assert_allclose(board.following()[0], expected, rtol=0, atol=2e-6)
        board.learn(BatchTrials(trial[None], trial[None], trial[None]))


def test_lengths_belong_to_fish_and_trial() -> None:
    """Even, within their spread, and the same whoever asks first."""
    spread = parse_lengths("uniform:20,50")
    assert spread is not None
    drawn = np.array([[spread.executed(s, t, 40) for t in range(1, 41)] for s in range(1, 101)])
    assert (drawn.min(), drawn.max()) == (20, 40)
    assert np.mean(drawn == 40) == pytest.approx(1 / 3, abs=0.03)
    for beats in range(20, 40):
        assert np.mean(drawn == beats) == pytest.approx(1 / 30, abs=0.012)
    noise = SimSettings("cut", lengths="uniform:20,50")
    assert noise.executed([7, 3], 5, 40).tolist() == [
        drawn[6, 4],
        drawn[2, 4],
    ]
    assert len({tuple(row) for row in drawn}) == 100
    scaled = parse_lengths("uniform:44,58,50")
    assert scaled is not None
    ends = {scaled.executed(s, 1, 40) for s in range(300)}
    assert ends == {35, 36, 37, 38, 39, 40}
    assert SimSettings("").executed([1, 2], 3, 40).tolist() == [40, 40]


@pytest.mark.parametrize(
    "text", ["uniform", "uniform:1", "uniform:5,4", "uniform:1,nan", "uniform:1,2,0", "normal:1,2"]
)
def test_lengths_that_make_no_sense(text: str) -> None:
    with pytest.raises(InputError, match="Write it like uniform:20,50"):
        parse_lengths(text)


SMALL = """
iterations = 6
seeds = 6
reference = "cosine:0.06,4,2"

[[plant]]
kappa_per_m = 10

[[noise]]
name = "cut"
lengths = "uniform:4,13"

[[law]]
name = "P"
lead_beats = 1

[[law]]
name = "average"
past = "mean"
lead_beats = 1

[[law]]
name = "moving 3"
past = "window"
lead_beats = 1
step_max_rad = 0.1
"""


def test_rows_of_cut_trials() -> None:
    """They tell how far each got, of what is measured, and the bounds of the whole."""
    recipe = parse(SMALL, "small")
    table = pa.concat_tables([run_cell(recipe, cell) for cell in cells(recipe)])
    found = Rows.of(table)
    rows = found.columns | {name: np.array(found.words(name)) for name in ("law", "swum_law")}
    recorded = rows["iteration"] > 0
    assert np.array_equal(rows["executed_beats"], rows["measured_beats"])
    assert {*rows["executed_beats"][recorded]} <= set(range(4, 11)) and len(
        {*rows["travel_m"]}
    ) > 50
    by_law = [rows["executed_beats"][rows["law"] == law] for law in ("P", "average", "moving 3")]
    assert np.array_equal(by_law[0], by_law[1]) and np.array_equal(by_law[0], by_law[2])
    assert rows["amplitude_min_rad"].min() >= 0 and rows["amplitude_max_rad"].max() <= 0.7853983
    limited = rows["law"] == "moving 3"
    assert rows["step_rad"][limited].max() <= 0.1 + 1e-7 < rows["step_rad"][~limited].max()
    assert {*rows["swum_law"][recorded]} == {"p", "mean", "window"}
    claim = ClaimSpec(
        text="P is sooner there", statistic="reach", over="floor_lsq_m_s", where={"law": ["P"]},
        level=3.0, against={"law": ["average"]}, at_most=1.0,
    )  # fmt: skip
    assert judge(claim, found).holds


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("uniform:4,13", "about 5"), "noise cut: 'about 5' is no length of trials"),
        (('past = "mean"', 'past = "some"'), "past = some is not for kind p"),
        (('past = "mean"', 'past = "mean"\nkind = "model"'), "past = mean is not for kind model"),
        (
            ('past = "window"', 'past = "window"\nwindow = 9'),
            "window: expected a whole number <= 8",
        ),
    ],
)
def test_bad_recipes_of_cut_trials(change: tuple[str, str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        parse(SMALL.replace(*change), "small")


@pytest.mark.soak
@pytest.mark.parametrize("name", ["cut-trials", "cut-trials-lead", "cut-trials-limits"])
def test_packaged_studies_hold(name: str) -> None:
    """With all their fish; some minutes."""
    recipe = load(name)
    table = pa.concat_tables([run_cell(recipe, cell) for cell in cells(recipe)])
    found = summarise(recipe, table)
    assert [claim.text for claim in found.failed] == []
