"""Sweeps: the same bytes however they are computed, claims, and recipes that make no sense."""

from __future__ import annotations

import json
import multiprocessing
import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from tailbeat.app.cli import run
from tailbeat.core import law as laws
from tailbeat.core.errors import InputError
from tailbeat.core.extras import LazyModule, need
from tailbeat.core.law import Law
from tailbeat.core.law_memory import first_amplitudes
from tailbeat.core.parallel import terminate
from tailbeat.core.reference import from_text
from tailbeat.learning.fish_model import SIGMA_M_S
from tailbeat.studies.montecarlo import cell as cell_module
from tailbeat.studies.montecarlo import learners, runner
from tailbeat.studies.montecarlo.batch import BatchTrials, FishBatch
from tailbeat.studies.montecarlo.cell import Cell, cells, run_cell
from tailbeat.studies.montecarlo.recipe import ClaimSpec, Recipe, load, parse
from tailbeat.studies.montecarlo.results import GROUP, Rows, identity
from tailbeat.studies.montecarlo.runner import Interrupted, StudyFolder, compute, run_study
from tailbeat.studies.montecarlo.summary import judge, summarise

CLAIM = """
[[claim]]
text = "learns"
statistic = "median"
where = { law = "model" }
at_most = 1
"""
TINY = """
title = "Tiny"
reference = "cosine:0.05,3,2"
iterations = 3
seeds = 3
chunk = 2

[[plant]]
kappa_per_m = [10, 20]

[[law]]
name = "board"
lead_beats = 1

[[law]]
name = "repeats"
kind = "repeats"

[[claim]]
text = "the board's law gets better"
statistic = "median"
where = { law = "board" }
iteration = 3
against = { iteration = 1 }
at_most = 0.9
"""

# Long enough for BLAS to use threads, which changes last bits.
ALGEBRA = """
reference = "trapezoid:0.06,20,60"
iterations = 1
seeds = 1

[[plant]]
kappa_per_m = 10

[[law]]
name = "model"
kind = "model"

[[law]]
name = "design"
kind = "design"
"""


@pytest.fixture(scope="module")
def tiny() -> Recipe:
    return parse(TINY, "tiny")


@pytest.fixture(scope="module")
def expected(tiny: Recipe, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """What results.parquet must hold: put together from the cells without any runner."""
    return _put_together(tiny, tmp_path_factory.mktemp("expected"))


@pytest.fixture(scope="module")
def algebra(tmp_path_factory: pytest.TempPathFactory) -> tuple[Recipe, bytes]:
    """A recipe with much linear algebra, and its results.parquet."""
    recipe = parse(ALGEBRA, "algebra")
    with threadpool_limits(limits=2):
        return recipe, _put_together(recipe, tmp_path_factory.mktemp("algebra"))


def _put_together(recipe: Recipe, folder: Path) -> bytes:
    store = StudyFolder(folder)
    store.open(recipe)
    for cell in reversed(cells(recipe)):
        store.put(cell, compute(recipe, cell))
    return store.finish(cells(recipe)).read_bytes()


def test_rows_are_what_the_laws_and_the_plant_say(tiny: Recipe) -> None:
    """Re-computed fish by fish with the law for one trial and the errors by hand."""
    cell = cells(tiny)[0]
    rows = run_cell(tiny, cell).to_pydict()
    assert cell.law.name == "board" and rows["seed"] == [1] * 4 + [2] * 4
    assert rows["iteration"] == [0, 1, 2, 3] * 2
    wanted = from_text(tiny.reference).speed_m_s
    assert rows["max_abs_error_m_s"][0] == wanted.max()
    law = Law(lead_beats=1, amplitude_max_rad=tiny.amplitude_max_rad)
    alone = FishBatch("tank", [{"kappa_per_m": 10.0, "seed": 2}])
    amplitude = first_amplitudes(law, wanted)
    for iteration in (1, 2, 3):
        applied = laws.saturate(law, amplitude)
        recorded = alone.run(applied[None, :].astype(np.float64), iteration)
        row = 4 + iteration
        assert rows["max_abs_error_m_s"][row] == np.abs(wanted - recorded.speed_m_s[0]).max()
        assert rows["true_max_abs_error_m_s"][row] == np.abs(wanted - recorded.true_m_s[0]).max()
        rms = np.sqrt(np.mean((wanted - recorded.true_m_s[0]) ** 2))
        assert rows["true_rms_error_m_s"][row] == pytest.approx(rms, rel=1e-12)
        assert rows["ratio"][row] == pytest.approx(
            rows["max_abs_error_m_s"][row] / rows["max_abs_error_m_s"][row - 1]
        )
        error, measured = laws.errors_of(wanted, recorded.speed_m_s[0])
        amplitude, _ = laws.update(law, amplitude, error, measured)


@pytest.mark.parametrize("seed", [1, 2])
def test_the_batch_learns_bit_for_bit_as_one_fish_does(seed: int) -> None:
    """40 fish with different laws, gaps in the speeds and saturation, over five trials."""
    rng = np.random.default_rng(seed)
    reference = from_text("thesis")
    many = [
        Law(
            kp_rad_s_m=float(rng.uniform(1, 12)),
            kd_rad_s2_m=float(rng.uniform(-1, 1)),
            lead_beats=int(rng.integers(0, 4)),
            q_len=int(rng.integers(1, 5)),
            tail=int(rng.integers(0, 2)),
            amplitude_max_rad=0.5,
        )
        for _ in range(40)
    ]
    board = learners.BoardLaw(many, 0.0)
    board.begin(reference)
    stored = [first_amplitudes(law, reference.speed_m_s) for law in many]
    for _ in range(5):
        speed = rng.uniform(0, 0.15, (len(many), reference.beats))
        speed[rng.uniform(size=speed.shape) < 0.03] = np.nan
        for i, law in enumerate(many):
            applied = laws.saturate(law, stored[i])
            assert np.array_equal(board.following()[i], applied.astype(np.float64)), law
            stored[i], _ = laws.update(
                law, stored[i], *laws.errors_of(reference.speed_m_s, speed[i])
            )
        board.learn(BatchTrials(speed, speed, speed))
    assert any((amplitude > 0.5).any() for amplitude in stored)


def test_the_batch_rolls_back_as_the_board_does() -> None:
    """Two trials 1.5 times as bad as the best bring the best back; one fish has better ones."""
    reference = from_text("cosine:0.05,3,2")
    board = learners.BoardLaw([Law(), Law()], 1.3)
    board.begin(reference)
    best = board.following().copy()
    wanted = reference.speed_m_s.astype(np.float64)
    for error, verdict in ((0.02, ["", ""]), (0.03, ["", ""]), (0.03, ["rolled_back", ""])):
        speed = np.array([wanted - error, wanted - 0.01])
        assert board.learn(BatchTrials(speed, speed, speed))["verdict"] == verdict
    assert np.array_equal(board.following()[0], best[0])
    assert (board.following()[1] > best[1]).any()


def test_a_fish_without_speeds_keeps_its_amplitudes() -> None:
    reference = from_text("cosine:0.05,3,2")
    board = learners.BoardLaw([Law(), Law()], 0.0)
    board.begin(reference)
    before = board.following().copy()
    speed = np.zeros((2, reference.beats))
    speed[0] = np.nan
    board.learn(BatchTrials(speed, speed, speed))
    assert np.array_equal(board.following()[0], before[0])
    assert (board.following()[1] > before[1]).any()


@pytest.mark.parametrize("cores", [1, 2])
def test_the_same_bytes_on_any_number_of_cores(
    tiny: Recipe, expected: bytes, tmp_path: Path, cores: int
) -> None:
    outcome = run_study(tiny, tmp_path, cores=cores)
    assert outcome.computed == outcome.cells == 8
    assert outcome.results.read_bytes() == expected


def test_the_same_bytes_of_linear_algebra(algebra: tuple[Recipe, bytes], tmp_path: Path) -> None:
    """In processes of their own, however many threads they were told to use."""
    recipe, expected = algebra
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("OPENBLAS_NUM_THREADS", "1")
        outcome = run_study(recipe, tmp_path, cores=2)
    assert outcome.results.read_bytes() == expected


def test_cells_are_computed_with_one_thread_each(
    tiny: Recipe, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As long as any thread of this process computes one; afterwards everything is as before."""
    both = threading.Barrier(2, timeout=600)
    first_done = threading.Event()
    seen: list[set[int]] = []

    def run(recipe: Recipe, cell: Cell) -> object:
        both.wait()
        if cell.index == 1:
            assert first_done.wait(600)
        seen.append(_threads())
        return run_cell(recipe, cell)

    monkeypatch.setattr(runner, "run_cell", run)
    with threadpool_limits(limits=2):
        others = [
            threading.Thread(target=compute, args=(tiny, cell), daemon=True)
            for cell in cells(tiny)[:2]
        ]
        for one in others:
            one.start()
        others[0].join(600)
        first_done.set()
        others[1].join(600)
        assert seen == [{1}, {1}]
        assert _threads() == {2}


def _threads() -> set[int]:
    return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}


def test_the_same_bytes_after_an_interruption(
    tiny: Recipe, expected: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C after three cells; one of them is then damaged, as by a power cut."""
    computed: list[int] = []

    def here(recipe: Recipe, missing: list[Cell], cores: int) -> Iterator[tuple[Cell, bytes]]:
        for cell in reversed(missing):
            if len(computed) == 3:
                raise KeyboardInterrupt
            computed.append(cell.index)
            yield cell, compute(recipe, cell)

    monkeypatch.setattr(runner, "_computed_here", here)
    with pytest.raises(Interrupted, match=r"3 of 8 cells done. The same command"):
        run_study(tiny, tmp_path)
    assert not StudyFolder(tmp_path).results.exists()
    assert StudyFolder(tmp_path).read().num_rows > 0
    damaged = StudyFolder(tmp_path).part(cells(tiny)[computed[1]])
    damaged.write_bytes(damaged.read_bytes()[:100])
    del computed[:]
    computed.extend([-1] * 4)  # never three again
    outcome = run_study(tiny, tmp_path)
    assert outcome.computed == 6
    assert outcome.results.read_bytes() == expected


def test_the_same_bytes_by_a_dask_cluster(
    tiny: Recipe, expected: bytes, algebra: tuple[Recipe, bytes], tmp_path: Path
) -> None:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None,
        protocol="tcp", host="127.0.0.1",
    ) as cluster:  # fmt: skip
        outcome = run_study(tiny, tmp_path / "tiny", scheduler=cluster.scheduler_address)
        assert outcome.results.read_bytes() == expected
        recipe, bytes_of_algebra = algebra
        cell_module._ground.cache_clear()
        with threadpool_limits(limits=1):
            outcome = run_study(recipe, tmp_path / "algebra", scheduler=cluster.scheduler_address)
        assert outcome.results.read_bytes() == bytes_of_algebra
        with pytest.MonkeyPatch.context() as patch:
            here = identity() | {"numpy": "0.0"}
            patch.setattr("tailbeat.studies.montecarlo.runner.identity", _Once(here))
            with pytest.raises(InputError, match=r"has another numpy .* here 0.0"):
                run_study(
                    tiny.with_seeds(4), tmp_path / "other", scheduler=cluster.scheduler_address
                )


def test_a_worker_that_joins_later_must_be_alike(
    tiny: Recipe, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its task says so: the workers that were there at the start passed."""
    distributed = pytest.importorskip("distributed")

    def another_there() -> dict[str, str]:
        main = threading.current_thread() is threading.main_thread()
        return identity() if main else identity() | {"scipy": "0.1"}

    monkeypatch.setattr("tailbeat.studies.montecarlo.runner.identity", another_there)
    monkeypatch.setattr(
        "tailbeat.studies.montecarlo.runner._check_workers", lambda client, scheduler: None
    )
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None,
            protocol="tcp", host="127.0.0.1",
        ) as cluster,
        pytest.raises(InputError, match=r"joined later has another scipy \(0.1; here"),
    ):  # fmt: skip
        run_study(tiny, tmp_path, scheduler=cluster.scheduler_address)


class _Once:
    """A worker's ``identity`` is the real one; this is what the client has."""

    def __init__(self, here: dict[str, str]) -> None:
        self.here = here

    def __call__(self) -> dict[str, str]:
        return self.here

    def __reduce__(self) -> str | tuple[object, ...]:
        return (_real_identity, ())


def _real_identity() -> object:
    return identity


def test_a_cluster_that_is_not_there(
    tiny: Recipe, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("tailbeat.studies.montecarlo.runner._ANSWER_S", 0.2)
    for address in ("tcp://127.0.0.1:1", "nonsense"):
        with pytest.raises(InputError, match="no Dask scheduler answers at"):
            run_study(tiny, tmp_path, scheduler=address)


def test_a_cluster_without_the_package(
    tiny: Recipe, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    monkeypatch.setattr(
        runner, "distributed", LazyModule("distributed", lambda: need(*runner._NEEDED))
    )
    with pytest.raises(InputError, match=r"needs Dask.*tools/bootstrap cluster"):
        run_study(tiny, tmp_path, scheduler="tcp://127.0.0.1:1")


def test_a_folder_of_something_else_is_refused(tiny: Recipe, tmp_path: Path) -> None:
    StudyFolder(tmp_path).open(tiny)
    StudyFolder(tmp_path).open(parse(TINY[: TINY.index("[[claim]]")], "tiny"))  # claims only judge
    with pytest.raises(InputError, match=r"results of another recipe .* --out"):
        StudyFolder(tmp_path).open(tiny.with_seeds(7))
    manifest = json.loads((tmp_path / "sweep.json").read_text())
    manifest["code"] = "0123"
    (tmp_path / "sweep.json").write_text(json.dumps(manifest))
    with pytest.raises(InputError, match="results of another build of tailbeat"):
        StudyFolder(tmp_path).open(tiny)


def test_a_damaged_part_is_computed_again(tiny: Recipe, tmp_path: Path) -> None:
    """Whatever piece of it is lost."""
    store, cell = StudyFolder(tmp_path), cells(tiny)[0]
    store.open(tiny)
    store.put(cell, compute(tiny, cell))
    assert store.has(cell)
    part = store.part(cell)
    data = part.read_bytes()
    for begin in range(0, len(data) - 64, 61):
        part.write_bytes(data[:begin] + bytes(64) + data[begin + 64 :])
        assert not store.has(cell), begin
    for kept in range(0, len(data), 97):
        part.write_bytes(data[:kept])
        assert not store.has(cell), kept
    with pytest.raises(InputError, match=r"part is damaged .* computes again what is missing"):
        store.read()
    part.write_bytes(data)
    assert store.read().num_rows == 8


def test_a_folder_that_was_only_just_made(tiny: Recipe, tmp_path: Path) -> None:
    """The power failed between making it and saying what it is of."""
    (tmp_path / "parts").mkdir()
    StudyFolder(tmp_path).open(tiny)
    (tmp_path / "sweep.json").unlink()
    StudyFolder(tmp_path).open(tiny)
    StudyFolder(tmp_path).put(cells(tiny)[0], b"x")
    (tmp_path / "sweep.json").unlink()
    with pytest.raises(InputError, match=r"holds results, but no sweep.json says of what"):
        StudyFolder(tmp_path).open(tiny)


def test_results_are_judged_by_the_claims_of_today(tiny: Recipe, tmp_path: Path) -> None:
    store = StudyFolder(tmp_path)
    store.open(tiny)
    store.open(parse(TINY.replace("at_most = 0.9", "at_most = 0.8"), "tiny"))
    assert [claim.at_most for claim in store.recipe().claims] == [0.8]


def test_a_fish_that_fails_does_not_end_a_sweep() -> None:
    """No thrust below 0.78 rad of at most 0.785: it cannot be identified, the others can."""
    recipe = parse(
        ALGEBRA.replace("trapezoid:0.06,20,60", "cosine:0.05,3,2")
        .replace("kappa_per_m = 10", "dead_zone_rad = [0.2, 0.78]")
        .replace("seeds = 1", "seeds = 2")
        + CLAIM,
        "fail",
    )
    model = [cell for cell in cells(recipe) if cell.law.name == "model"]
    table = pa.concat_tables([run_cell(recipe, cell) for cell in model])
    rows = table.to_pydict()
    failed = [plant == "dead 0.78" for plant in rows["plant"]]
    assert sum(failed) == 4
    assert [verdict == "failed" for verdict in rows["verdict"]] == failed
    assert [np.isnan(value) for value in rows["true_max_abs_error_m_s"]] == failed
    found = summarise(recipe, table)
    assert len(found.failures) == 2
    assert found.failures[1].startswith("dead 0.78 / model / usual, seed 2: the fish did not move")
    assert [(line.fish, line.failed) for line in found.lines] == [(2, 0), (2, 2)]
    assert np.isfinite(found.lines[0].median_m_s).all()
    assert [claim.holds for claim in found.claims] == [False]
    assert "dead 0.78" in found.claims[0].group


def test_one_that_fails_leaves_the_others_of_its_cell_as_they_are(
    tiny: Recipe, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fish 2 of a chunk of two; fish 1 has the very rows it has otherwise."""
    cell = cells(tiny)[0]
    whole = run_cell(tiny, cell).to_pylist()
    trial = cell_module._trials

    def fails(recipe: Recipe, cell: Cell, phases: cell_module.Phases) -> pa.Table:
        if 2 in cell.seeds:
            raise ValueError("array must not contain infs or NaNs")
        return trial(recipe, cell, phases)

    monkeypatch.setattr(cell_module, "_trials", fails)
    rows = run_cell(tiny, cell).to_pylist()
    assert repr(rows[:4]) == repr(whole[:4])
    assert [row["seed"] for row in rows] == [1] * 4 + [2] * 4
    assert {row["failure"] for row in rows[4:]} == {
        "ValueError('array must not contain infs or NaNs')"
    }


def test_a_reference_for_what_identification_knows() -> None:
    """Of another fish of the kind: near the one for the plant itself, not the same."""
    recipe = load("feasible")
    assert recipe.reference == "feasible, identified"
    cell = cells(recipe)[0]
    found = cell_module._ground_of(recipe, cell, recipe.reference).reference.speed_m_s
    right = cell_module._ground_of(recipe, cell, "feasible").reference.speed_m_s
    assert 0 < np.abs(found - right).max() < 0.01


def test_a_beat_without_a_speed_has_the_usual_standard_deviation() -> None:
    speed = np.array([[0.1, np.nan]])
    recorded = learners.speeds_of(BatchTrials(speed, speed / 50, speed), np.ones((1, 2)), 1.0, 7)[0]
    assert np.array_equal(recorded.sigma_m_s, [0.002, SIGMA_M_S])
    assert recorded.measured.tolist() == [True, False]
    assert (recorded.beat_s, recorded.reference_crc) == (1.0, 7)


def test_corners() -> None:
    recipe = load("model-corners")
    assert len(recipe.corners) == 16
    assert len({corner.name for corner in recipe.corners}) == 16
    model = [cell for cell in cells(recipe) if cell.law.kind == "model"]
    assert len({(cell.plant.name, cell.corner.name) for cell in model}) == 64


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("title", "titel"), "recipe tiny: unknown key titel"),
        (("kappa_per_m = [10, 20]", "colour = 1"), "plant 1: the simulator has no value colour"),
        (("kappa_per_m = [10, 20]", 'plant = "pond"'), "there is no plant pond"),
        (("kappa_per_m = [10, 20]", "kappa_per_m = -1"), "the simulator cannot run plant 'tank'"),
        (("kappa_per_m = [10, 20]", 'kappa_per_m = "x"'), "kappa_per_m = 'x' is not a number"),
        (("lead_beats = 1", "leed = 1"), "law[0]: unknown key leed"),
        (('kind = "repeats"', 'kind = "magic"'), "there is no law of kind magic"),
        (('name = "repeats"', 'name = "board"'), "two of law are called board"),
        (("seeds = 3", "seeds = 0"), "seeds: expected a whole number >= 1"),
        (("seeds = 3", "seeds = 2.5"), "seeds: expected a whole number"),
        (("cosine:0.05,3,2", "sine"), "there is no reference 'sine'"),
        (("at_most = 0.9", ""), "gets better' has no bound"),
        (('"median"', '"mean"'), "there is no statistic mean"),
        (
            ('law = "board" }', 'law = "bord" }'),
            "claim 1, 'the board's law gets better': there is no law bord",
        ),
        (("iteration = 3\nagainst", 'of = "error"\nagainst'), "there is no column error"),
        (("iteration = 3\nagainst", "iteration = 60\nagainst"), "there is no iteration 60"),
        (("title =", "title"), "no TOML"),
        (("[[law]]", "[law]"), "no TOML"),
        (("chunk = 2", "before = 'thesis'"), "before needs before_iterations"),
        (("chunk = 2", "before = 'thesis'\nbefore_iterations = 1"), "repeats cannot change"),
    ],
)
def test_bad_recipes_give_one_clear_line(change: tuple[str, str], message: str) -> None:
    text = TINY.replace(*change)
    assert text != TINY
    with pytest.raises(InputError) as caught:
        parse(text, "tiny")
    assert str(caught.value).startswith("recipe tiny")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
    assert caught.value.remedy


def test_a_recipe_that_is_not_there() -> None:
    with pytest.raises(InputError, match=r"there is no recipe 'nowhere'. Known are camera-noise"):
        load("nowhere")


def test_fish_are_others_each_time_and_the_same_in_a_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(runner, "_computed_here", _in_this_process)
    drawn = iter((2, 3, 5))
    monkeypatch.setattr("secrets.randbelow", lambda _: next(drawn))
    recipe = tmp_path / "tiny.toml"
    recipe.write_text(TINY)
    first = []
    for folder in ("one", "one", "two"):
        command = ["sim", "montecarlo", str(recipe), "--out", str(tmp_path / folder)]
        assert run([*command, "--seeds", "1", "--json"]) == 0
        document = json.loads(capsys.readouterr().out)
        first.append(document["first_seed"])
        seeds = pq.read_table(tmp_path / folder / "results.parquet")["seed"].to_pylist()
        assert set(seeds) == {first[-1]}
    assert first[0] == first[1] != first[2] and min(first) >= 1_000_000


def test_an_interval_is_that_of_other_fish() -> None:
    """Of the median of 40 normal values: a fish more or less in the middle; shares likewise. A
    counterpart of the same fish goes with them."""
    rng = np.random.default_rng(5)
    count = 40
    names = {name: np.zeros(2 * count, dtype=int) for name in GROUP}
    values = np.tile(rng.normal(10, 1, count), 2) * np.repeat([1.0, 1.0 / 3], count)
    columns = names | {
        "law": np.repeat([0, 1], count), "seed": np.tile(np.arange(count) + 7, 2),
        "iteration": np.ones(2 * count, dtype=int), "true_max_abs_error_m_s": values,
    }  # fmt: skip
    rows = Rows(columns, {name: ["a"] for name in GROUP} | {"law": ["a", "b"]})
    median = judge(ClaimSpec(text="", statistic="median", where={"law": "a"}, at_most=11), rows)
    low, high = median.interval
    assert low < median.figure < high and 0.3 < high - low < 1.3
    against = ClaimSpec(text="", statistic="median", where={"law": "a"}, against={"law": "b"},
                        at_most=4)  # fmt: skip
    assert judge(against, rows).interval == pytest.approx((3, 3))


@pytest.mark.painted
def test_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(runner, "_computed_here", _in_this_process)
    recipe, out, plot = tmp_path / "tiny.toml", tmp_path / "out", tmp_path / "tiny.png"
    recipe.write_text(TINY)
    command = ["sim", "montecarlo", str(recipe), "--out", str(out), "--seeds", "2", "--pinned"]
    assert run([*command, "--json", "--plot", str(plot)]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["computed_cells"] == 4
    assert [claim["holds"] for claim in document["claims"]] == [True]
    assert len(document["groups"]) == 4
    assert plot.read_bytes().startswith(b"\x89PNG")
    assert pq.read_table(out / "results.parquet").num_rows == 2 * 2 * 2 * 4
    recipe.write_text(TINY.replace("at_most = 0.9", "at_most = 0.001"))
    assert run([*command, "--check"]) == 1
    assert "FAILS: the board's law gets better" in capsys.readouterr().out
    assert run(["sim", "montecarlo", "--summary", str(out)]) == 0
    assert "FAILS: the board's law gets better" in capsys.readouterr().out
    assert run(["sim", "montecarlo", "--list"]) == 0
    assert "thesis-law" in capsys.readouterr().out
    assert run(["sim", "montecarlo"]) == 2
    assert run(["sim", "montecarlo", "--summary", str(tmp_path / "none")]) == 1


def _in_this_process(
    recipe: Recipe, missing: list[Cell], cores: int
) -> Iterator[tuple[Cell, bytes]]:
    for cell in missing:
        yield cell, compute(recipe, cell)


def test_half_a_result_in_the_pipe_does_not_keep_it_from_ending() -> None:
    """What a process leaves there that is terminated while it sends."""
    pool = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"))
    assert pool.submit(abs, -1).result() == 1
    children = set(pool._processes.values())
    pool._result_queue._writer._send((1000).to_bytes(4, "big") + b"half")  # type: ignore[attr-defined]
    terminate(pool, children)
    pool.shutdown(wait=True, cancel_futures=True)
    assert not any(child.is_alive() for child in children)


def test_ctrl_c_stops_it_quietly(tmp_path: Path) -> None:
    """While cells are computed by real processes."""
    slow = TINY.replace("iterations = 3", "iterations = 50").replace("seeds = 3", "seeds = 400")
    (tmp_path / "slow.toml").write_text(slow)
    code = (
        "import os, signal, sys\n"
        "from tailbeat.app.cli import run\n"
        "import tailbeat.studies.montecarlo.runner as runner\n"
        "put = runner.StudyFolder.put\n"
        "def once(self, cell, data):\n"
        "    put(self, cell, data)\n"
        "    os.killpg(0, signal.SIGINT)\n"
        "runner.StudyFolder.put = once\n"
        "if __name__ == '__main__':\n"
        "    out = ['--out', sys.argv[2], '--cores', '2', '--pinned']\n"
        "    sys.exit(run(['sweep', sys.argv[1], *out]))\n"
    )
    script = tmp_path / "script.py"
    script.write_text(code)
    done = subprocess.run(
        [sys.executable, str(script), str(tmp_path / "slow.toml"), str(tmp_path / "out")],
        capture_output=True, text=True, start_new_session=True, timeout=600,
    )  # fmt: skip
    assert done.returncode == 130, done.stderr
    assert done.stderr.count("\n") == 1 and "The same command goes on from there" in done.stderr
    assert len(list((tmp_path / "out" / "parts").glob("*.part"))) >= 1
