"""Sweeps: the same bytes however they are computed, claims, and recipes that make no sense."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from tailbeat import laws
from tailbeat.cli import run
from tailbeat.errors import InputError
from tailbeat.laws import Law
from tailbeat.reference import from_text
from tailbeat.sweep import learners, runner
from tailbeat.sweep.cell import Cell, cells, run_cell
from tailbeat.sweep.recipe import Claim, Recipe, load, packaged, parse
from tailbeat.sweep.results import SCHEMA, Store, identity
from tailbeat.sweep.runner import Interrupted, compute, sweep
from tailbeat.sweep.shoal import Swims
from tailbeat.sweep.summary import Rows, judge

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


@pytest.fixture(scope="module")
def tiny() -> Recipe:
    return parse(TINY, "tiny")


@pytest.fixture(scope="module")
def expected(tiny: Recipe, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """What results.parquet must hold: put together from the cells without any runner."""
    store = Store(tmp_path_factory.mktemp("expected"))
    store.open(tiny)
    for cell in reversed(cells(tiny)):
        store.put(cell, compute(tiny, cell))
    return store.finish(cells(tiny)).read_bytes()


def test_rows_are_what_the_laws_and_the_plant_say(tiny: Recipe) -> None:
    """Re-computed fish by fish with the law for one trial and the errors by hand."""
    cell = cells(tiny)[0]
    rows = run_cell(tiny, cell).to_pydict()
    assert cell.law.name == "board" and rows["seed"] == [1] * 4 + [2] * 4
    assert rows["iteration"] == [0, 1, 2, 3] * 2
    wanted = from_text(tiny.reference).speed_m_s
    assert rows["max_abs_error_m_s"][0] == wanted.max()
    law = Law(lead_beats=1, amplitude_max_rad=tiny.amplitude_max_rad)
    alone = learners.Shoal("tank", [{"kappa_per_m": 10.0, "seed": 2}])
    amplitude = laws.first(law, wanted)
    for iteration in (1, 2, 3):
        applied = laws.saturate(law, amplitude)
        swum = alone.swim(applied[None, :].astype(np.float64), iteration)
        row = 4 + iteration
        assert rows["max_abs_error_m_s"][row] == np.abs(wanted - swum.speed_m_s[0]).max()
        assert rows["true_max_abs_error_m_s"][row] == np.abs(wanted - swum.true_m_s[0]).max()
        rms = np.sqrt(np.mean((wanted - swum.true_m_s[0]) ** 2))
        assert rows["true_rms_error_m_s"][row] == pytest.approx(rms, rel=1e-12)
        assert rows["ratio"][row] == pytest.approx(
            rows["max_abs_error_m_s"][row] / rows["max_abs_error_m_s"][row - 1]
        )
        error, measured = laws.errors_of(wanted, swum.speed_m_s[0])
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
    board = learners.Board(many, 0.0)
    board.begin(reference)
    stored = [laws.first(law, reference.speed_m_s) for law in many]
    for _ in range(5):
        speed = rng.uniform(0, 0.15, (len(many), reference.beats))
        speed[rng.uniform(size=speed.shape) < 0.03] = np.nan
        for i, law in enumerate(many):
            applied = laws.saturate(law, stored[i])
            assert np.array_equal(board.following()[i], applied.astype(np.float64)), law
            stored[i], _ = laws.update(
                law, stored[i], *laws.errors_of(reference.speed_m_s, speed[i])
            )
        board.learn(Swims(speed, speed, speed))
    assert any((amplitude > 0.5).any() for amplitude in stored)


def test_the_batch_rolls_back_as_the_board_does() -> None:
    """Two trials 1.5 times as bad as the best bring the best back; one fish has better ones."""
    reference = from_text("cosine:0.05,3,2")
    board = learners.Board([Law(), Law()], 1.3)
    board.begin(reference)
    best = board.following().copy()
    wanted = reference.speed_m_s.astype(np.float64)
    for error, verdict in ((0.02, ["", ""]), (0.03, ["", ""]), (0.03, ["rolled_back", ""])):
        speed = np.array([wanted - error, wanted - 0.01])
        assert board.learn(Swims(speed, speed, speed)).verdict == verdict
    assert np.array_equal(board.following()[0], best[0])
    assert (board.following()[1] > best[1]).any()


def test_a_fish_without_speeds_keeps_its_amplitudes() -> None:
    reference = from_text("cosine:0.05,3,2")
    board = learners.Board([Law(), Law()], 0.0)
    board.begin(reference)
    before = board.following().copy()
    speed = np.zeros((2, reference.beats))
    speed[0] = np.nan
    board.learn(Swims(speed, speed, speed))
    assert np.array_equal(board.following()[0], before[0])
    assert (board.following()[1] > before[1]).any()


@pytest.mark.parametrize("cores", [1, 2])
def test_the_same_bytes_on_any_number_of_cores(
    tiny: Recipe, expected: bytes, tmp_path: Path, cores: int
) -> None:
    outcome = sweep(tiny, tmp_path, cores=cores)
    assert outcome.computed == outcome.cells == 8
    assert outcome.results.read_bytes() == expected


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
        sweep(tiny, tmp_path)
    assert not Store(tmp_path).results.exists()
    assert Store(tmp_path).read().num_rows > 0
    damaged = Store(tmp_path).part(cells(tiny)[computed[1]])
    damaged.write_bytes(damaged.read_bytes()[:100])
    del computed[:]
    computed.extend([-1] * 4)  # never three again
    outcome = sweep(tiny, tmp_path)
    assert outcome.computed == 6
    assert outcome.results.read_bytes() == expected


def test_the_same_bytes_by_a_dask_cluster(tiny: Recipe, expected: bytes, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None,
        protocol="tcp", host="127.0.0.1",
    ) as cluster:  # fmt: skip
        outcome = sweep(tiny, tmp_path, scheduler=cluster.scheduler_address)
        assert outcome.results.read_bytes() == expected
        with pytest.MonkeyPatch.context() as patch:
            here = identity() | {"numpy": "0.0"}
            patch.setattr("tailbeat.sweep.cluster.identity", _Once(here))
            with pytest.raises(InputError, match=r"has another numpy .* here 0.0"):
                sweep(
                    replace(tiny, seeds=4), tmp_path / "other", scheduler=cluster.scheduler_address
                )


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
    monkeypatch.setattr("tailbeat.sweep.cluster._ANSWER_S", 0.2)
    for address in ("tcp://127.0.0.1:1", "nonsense"):
        with pytest.raises(InputError, match="no Dask scheduler answers at"):
            sweep(tiny, tmp_path, scheduler=address)


def test_a_cluster_without_the_package(
    tiny: Recipe, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"needs the package distributed.*tailbeat\[cluster\]"):
        sweep(tiny, tmp_path, scheduler="tcp://127.0.0.1:1")


def test_a_folder_of_something_else_is_refused(tiny: Recipe, tmp_path: Path) -> None:
    Store(tmp_path).open(tiny)
    Store(tmp_path).open(replace(tiny, claims=[]))  # claims only judge
    with pytest.raises(InputError, match=r"results of another recipe .* --out"):
        Store(tmp_path).open(tiny.with_seeds(7))
    manifest = json.loads((tmp_path / "sweep.json").read_text())
    manifest["code"] = "0123"
    (tmp_path / "sweep.json").write_text(json.dumps(manifest))
    with pytest.raises(InputError, match="results of another build of tailbeat"):
        Store(tmp_path).open(tiny)


@pytest.mark.parametrize("name", list(packaged()))
def test_packaged_recipes_are_sound_and_claim_something(name: str) -> None:
    recipe = load(name)
    assert recipe.claims
    assert recipe.seeds >= 20
    assert len({cell.label for cell in cells(recipe)}) == len(cells(recipe))


def test_corners() -> None:
    recipe = load("model-corners")
    assert len(recipe.corners) == 16
    assert len({corner.name for corner in recipe.corners}) == 16
    model = [cell for cell in cells(recipe) if cell.law.kind == "model"]
    assert len({(cell.plant.name, cell.corner.name) for cell in model}) == 48


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("title", "titel"), "the recipe: unknown key titel"),
        (("kappa_per_m = [10, 20]", "colour = 1"), "plant 1: the simulator has no value colour"),
        (("kappa_per_m = [10, 20]", 'plant = "pond"'), "there is no plant pond"),
        (("kappa_per_m = [10, 20]", "kappa_per_m = -1"), "the simulator cannot run plant 'tank'"),
        (("kappa_per_m = [10, 20]", 'kappa_per_m = "x"'), "kappa_per_m = 'x' is not a number"),
        (("lead_beats = 1", "leed = 1"), "law board: unknown key leed"),
        (('kind = "repeats"', 'kind = "magic"'), "there is no law of kind magic"),
        (('name = "repeats"', 'name = "board"'), "two of law are called board"),
        (("seeds = 3", "seeds = 0"), "seeds and iterations must be 1 or more"),
        (("seeds = 3", "seeds = 2.5"), "seeds = 2.5 is not a whole number"),
        (("cosine:0.05,3,2", "sine"), "there is no reference 'sine'"),
        (("at_most = 0.9", ""), "claim 1 has no bound"),
        (('"median"', '"mean"'), "there is no statistic mean"),
        (('law = "board" }', 'law = "bord" }'), "there is no law 'bord'"),
        (("iteration = 3\nagainst", 'of = "error"\nagainst'), "there is no column error"),
        (("title =", "title"), "is not TOML"),
        (("[[law]]", "[law]"), "is not TOML"),
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


def _rows(**columns: object) -> Rows:
    length = max(len(np.atleast_1d(values)) for values in columns.values())
    filled = {field.name: np.full(length, "" if field.type == "string" else 0) for field in SCHEMA}
    for name, values in columns.items():
        filled[name] = np.broadcast_to(values, length)
    return Rows(filled)


def _claim(**values: object) -> Claim:
    return replace(Claim("it holds", "median", at_most=1.0), **values)  # type: ignore[arg-type]


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


def test_share_leaves_out_what_is_not_known() -> None:
    rows = _rows(iteration=1, ratio_inside=[1.0, 0.0, np.nan, 1.0, 1.0])
    assert judge(_claim(statistic="share", of="ratio_inside"), rows).figure == 0.75


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


def test_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(runner, "_computed_here", _in_this_process)
    recipe, out, plot = tmp_path / "tiny.toml", tmp_path / "out", tmp_path / "tiny.png"
    recipe.write_text(TINY)
    command = ["sweep", str(recipe), "--out", str(out), "--seeds", "2"]
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
    assert run(["sweep", "--summary", str(out)]) == 0
    assert "holds: the board's law gets better" in capsys.readouterr().out
    assert run(["sweep", "--list"]) == 0
    assert "thesis-law" in capsys.readouterr().out
    assert run(["sweep"]) == 2
    assert run(["sweep", "--summary", str(tmp_path / "none")]) == 1


def _in_this_process(
    recipe: Recipe, missing: list[Cell], cores: int
) -> Iterator[tuple[Cell, bytes]]:
    for cell in missing:
        yield cell, compute(recipe, cell)


def test_ctrl_c_stops_it_quietly(tmp_path: Path) -> None:
    """While cells are computed by real processes."""
    slow = TINY.replace("iterations = 3", "iterations = 50").replace("seeds = 3", "seeds = 400")
    (tmp_path / "slow.toml").write_text(slow)
    code = (
        "import os, signal, sys\n"
        "from tailbeat.cli import run\n"
        "import tailbeat.sweep.results as results\n"
        "put = results.Store.put\n"
        "def once(self, cell, data):\n"
        "    put(self, cell, data)\n"
        "    os.killpg(0, signal.SIGINT)\n"
        "results.Store.put = once\n"
        "if __name__ == '__main__':\n"
        "    sys.exit(run(['sweep', sys.argv[1], '--out', sys.argv[2], '--cores', '2']))\n"
    )
    script = tmp_path / "script.py"
    script.write_text(code)
    done = subprocess.run(
        [sys.executable, str(script), str(tmp_path / "slow.toml"), str(tmp_path / "out")],
        capture_output=True, text=True, start_new_session=True, timeout=60,
    )  # fmt: skip
    assert done.returncode == 130, done.stderr
    assert done.stderr.count("\n") == 1 and "The same command goes on from there" in done.stderr
    assert len(list((tmp_path / "out" / "parts").glob("*.parquet"))) >= 1
