"""The files in tests/data/written_by_0bf270a open, replay and report as they did when written."""

from __future__ import annotations

import gzip
import json
import math
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

from tailbeat.app.cli import run
from tailbeat.board.fish import Fish
from tailbeat.board.snapshot import Snapshot, restore
from tailbeat.core.arrays import F64
from tailbeat.core.csv import read_speeds
from tailbeat.core.law import load
from tailbeat.core.native import ffi, lib
from tailbeat.core.reference import from_csv
from tailbeat.core.speed_estimate import recompute_beats
from tailbeat.core.trial_file import read_trial
from tailbeat.experiment.analysis import analyse
from tailbeat.experiment.current import current, strayed
from tailbeat.experiment.export import FORMATS, export
from tailbeat.experiment.folder import Experiment, held_state
from tailbeat.experiment.library import FOLDER_VARIABLE, TrialLibrary
from tailbeat.experiment.wall_clock import BY_HOST, starts_of
from tailbeat.learning.identification import Identified, read_steady_speeds
from tailbeat.link.keystore import KeyStore, decode_key
from tailbeat.report.paper import draw_all
from tailbeat.sensors.camera.calibration.file import load_calibration
from tailbeat.session.log import held_before
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import SimBoard, SimTransport

Json = Any

RENAMED = {
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
"""Parameters, keys and words that have another name since 0bf270a: old to new. Written out, not the
product's table: an entry that is lost there is found here."""

FILES = Path(__file__).parents[2] / "data" / "written_by_0bf270a"
EXPECTED: dict[str, Any] = json.loads((FILES / "expected.json").read_bytes())
REPORTED: dict[str, Any] = json.loads((FILES / "reported.json").read_bytes())  # by 1a336f2
COMMANDS = [name for name, one in EXPECTED.items() if isinstance(one, dict) and "command" in one]
UNIQUE_ID = "73696d2d666973680100000000000000"
AWAY = (
    "LAW_GAIN", "LAW_KD", "LAW_LEAD", "LAW_TAIL", "LAW_Q_LEN", "LAW_FADE", "LAW_FADE_FROM",
    "LAW_KIND", "LAW_WINDOW", "LAW_BEYOND", "GLIDE_S",
)  # fmt: skip
PARAM_HEADER_BYTES, PARAM_ENTRY_BYTES, CRC_BYTES = 8, 20, 4


@pytest.fixture
def old(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the files, as the present folder; library and keys are those in it."""
    folder = tmp_path / "old"
    shutil.copytree(FILES, folder)
    for key in (folder / "keys").glob("*"):
        key.chmod(0o600)  # a clone does not keep it
    monkeypatch.setenv(FOLDER_VARIABLE, str(folder / "library"))
    monkeypatch.setenv("TAILBEAT_KEYS", str(folder / "keys"))
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture
def fresh() -> Iterator[Fish]:
    """The board on which the experiments were made, with nothing on it."""
    with Fish.connect("sim:tank?seed=1") as fish:
        yield fish


@pytest.fixture
def stored() -> Iterator[Fish]:
    """The present firmware on the storage that 0bf270a wrote."""
    board = SimBoard("tank", seed=2)
    board.flash = gzip.decompress((FILES / "store.bin.gz").read_bytes())
    board.world.power_cycle()
    with Fish(SimTransport(board)) as fish:
        fish.link.run(3.0)
        yield fish


@pytest.fixture
def defaults() -> dict[str, float]:
    """Of every parameter, by its name of now."""
    with Fish.connect("sim:tank?seed=3") as fish:
        return fish.params.values()


def renamed(told: Json) -> Json:
    """``told`` by 0bf270a in the words of now."""
    if isinstance(told, dict):
        return {RENAMED.get(key, key): renamed(value) for key, value in told.items()}
    if isinstance(told, list):
        return [renamed(value) for value in told]
    return RENAMED.get(told, told) if isinstance(told, str) else told


def missing(old: Json, new: Json, where: str = "") -> list[str]:
    """What ``old`` says and ``new`` does not. Keys may have come since, sentences may have changed;
    words, numbers and the order may not."""
    if isinstance(old, dict) and isinstance(new, dict):
        gone = [f"{where}.{key} is gone" for key in old if key not in new]
        both = (missing(old[key], new[key], f"{where}.{key}") for key in old if key in new)
        return [*gone, *(line for lines in both for line in lines)]
    if isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        rows = (
            missing(*pair, f"{where}[{at}]") for at, pair in enumerate(zip(old, new, strict=True))
        )
        return [line for lines in rows for line in lines]
    if isinstance(old, str) and isinstance(new, str) and " " in old:
        return []
    numbers = isinstance(old, float) and isinstance(new, float | int)
    same = math.isclose(old, new, rel_tol=1e-12) if numbers else old == new
    return [] if same else [f"{where}: {old!r} is now {new!r}"]


def params_of(told: dict[str, float]) -> dict[str, float]:
    return {RENAMED.get(name, name): value for name, value in told.items()}


def names_of(names: Sequence[str]) -> list[str]:
    return [RENAMED.get(name, name) for name in names]


def hexed(values: ArrayLike) -> str:
    return np.asarray(values, np.float32).tobytes().hex()


def bits(fish: Fish) -> dict[str, Any]:
    """What the board is to swim next and what was best, as float32."""
    visits = fish.visits()
    assert visits is not None
    return {
        "next": hexed(fish.amplitudes().values),
        "best": hexed(fish.amplitudes(best=True).values),
        "visits": [int(n) for n in visits],
        "iteration": fish.status().iteration,
    }


def series(letter: str) -> Experiment:
    return Experiment.open(FILES / EXPECTED[f"show_{letter}"]["command"][-1])


# What commands print


@pytest.mark.parametrize("name", COMMANDS)
def test_commands_print_the_same(old: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = EXPECTED[name]["command"]
    board = ["--connect", "sim:tank?seed=1"] if "--reference" in words[:2] else []
    assert run([*words, "--json", *board]) == 0, capsys.readouterr().err
    document = json.loads(capsys.readouterr().out)
    assert not missing(renamed(EXPECTED[name]["json"]), document)


def test_a_difference_is_found() -> None:
    told = {"a": [1, {"b": 0.5}], "c": "keep"}
    assert not missing(told, {**told, "new": 1})
    for other in ({"a": [1, {"b": 0.5}]}, {**told, "a": [1, {"b": 0.50001}]}, {**told, "c": "no"}):
        assert missing(told, other)


# Experiments


@pytest.mark.parametrize("letter", ["a", "b"])
def test_trials_have_the_same_bits(letter: str) -> None:
    found = [
        {
            "trial": trial.number,
            "iteration": trial.iteration,
            "amplitude_rad": hexed(trial.beats.amplitude_rad),
            "speed_m_s": hexed(trial.beats.speed_m_s),
            "recomputed_m_s": hexed(recompute_beats(trial)[0]),
        }
        for trial in series(letter).trials()
    ]
    assert found == EXPECTED[f"bits_{letter}"]


@pytest.mark.parametrize("letter", ["a", "b"])
def test_the_copy_of_the_board(letter: str) -> None:
    told, held = EXPECTED[f"held_{letter}"], held_state(series(letter))
    assert held is not None and held.learned is not None
    assert held.params == params_of(told["params"])
    assert (held.iteration, held.reference.hex()) == (told["iteration"], told["reference"])
    assert held.learned.hex() == told["learned"]


def curves(figure: Any) -> list[list[float]]:
    """The numbers behind all that is drawn, sorted, so that the order of drawing does not count."""
    found: list[F64] = []
    for axes in figure.axes:
        found += [line.get_xydata() for line in axes.lines]
        found += [patch.get_patch_transform().transform(patch.get_path().vertices)
                  for patch in axes.patches]  # fmt: skip
        for drawn in axes.collections:
            found += [path.vertices for path in drawn.get_paths()] + [drawn.get_offsets()]
    rows = [[float(v) for v in np.ma.filled(np.ma.asarray(one), np.nan).ravel()] for one in found]
    return sorted(rows, key=lambda row: [f"{value:.9e}" for value in row])


def reported() -> dict[str, Any]:
    """What reported.json holds, as the present tool gives it."""
    a, b = (analyse(series(letter)) for letter in "ab")
    drawings = [*draw_all([a]), *draw_all([b]), *draw_all([a, b])]
    figures = [{"name": d.picture.name, "curves": curves(d.printed)} for d in drawings]
    return {"figures": figures, "analysis": [a.document(), b.document()]}


def test_the_report_has_the_same_data() -> None:
    now = json.loads(json.dumps(reported()))
    assert not missing(renamed(REPORTED["analysis"]), now["analysis"])
    for old, new in zip(REPORTED["figures"], now["figures"], strict=True):
        assert RENAMED.get(old["name"], old["name"]) == new["name"]
        for was, curve in zip(old["curves"], new["curves"], strict=True):
            np.testing.assert_allclose(curve, was, rtol=1e-12, atol=0, err_msg=old["name"])


def test_the_export_has_the_same_numbers(tmp_path: Path) -> None:
    exported = series("a").folder / "export"
    export(series("a"), folder=tmp_path)
    for old in exported.glob("*.csv"):
        heads, rows = zip(*(table(path) for path in (old, tmp_path / old.name)), strict=True)
        for column, name in enumerate(heads[0]):
            there = heads[1].index(RENAMED.get(name, name))
            assert not missing(
                [renamed(row[column]) for row in rows[0]], [row[there] for row in rows[1]], name
            )


def test_an_old_experiment_is_exported_in_every_format(tmp_path: Path) -> None:
    files = export(series("a"), list(FORMATS), tmp_path)
    assert {path.suffix for path in files} == {".csv", ".mat", ".parquet", ".mcap", ".ulg"}
    logs = [path for path in files if path.suffix == ".ulg"]
    assert [read_trial(path).problems for path in logs] == [[]] * len(logs)
    assert {start.source for start in starts_of(series("a"), analyse(series("a")))} == {BY_HOST}


def table(path: Path) -> tuple[list[str], list[list[str]]]:
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    head, *rows = (line.split(",") for line in lines)
    return head, rows


def test_what_broken_off_procedures_left(fresh: Fish) -> None:
    held = held_before(Experiment.open(FILES / "left-behind" / "experiment"))
    assert held is not None
    assert (held.learned, held.next_trial) == ((FILES / "learned.bin").read_bytes(), 11)
    left = Snapshot.read(FILES / "left-behind" / "board")
    assert left.unique_id == fresh.unique_id() == UNIQUE_ID and left.learned is not None


def test_the_experiment_the_fish_is_in(old: Path, fresh: Fish) -> None:
    now = current(fresh)
    assert now is not None and now.name == series("b").name


# Library, records, other files


def test_the_library(old: Path) -> None:
    kept, problems = TrialLibrary.of(UNIQUE_ID).kept()
    found = [
        {
            "trial": one.trial.number,
            "mark": one.mark,
            "reference_crc": one.trial.reference_crc,
            "amplitude_rad": hexed(one.trial.beats.amplitude_rad),
            "speed_m_s": hexed(one.trial.beats.speed_m_s),
        }
        for one in kept
    ]
    assert (found, problems) == (EXPECTED["library"], [])
    book = TrialLibrary.of(UNIQUE_ID)
    assert {book.reference_name(one["reference_crc"]) for one in found if not one["mark"]} == {
        "hill",
        "slow",
    }
    assert book.identified() is not None and len(book.proposals()) == 1
    (learned,) = (book.folder / "learned").iterdir()
    assert Snapshot.read(learned).learned is not None


def test_records_on_a_fresh_board(fresh: Fish) -> None:
    fresh.upload_reference((FILES / "reference.bin").read_bytes())
    learned = (FILES / "learned.bin").read_bytes()
    fresh.upload_learned(learned)
    assert bits(fresh) == EXPECTED["learned"]
    assert fresh.learned_record() == learned


def test_a_backup_goes_back(fresh: Fish, defaults: dict[str, float]) -> None:
    (folder,) = (FILES / "backup").iterdir()
    backup = Snapshot.read(folder)
    told = params_of(json.loads((folder / "board.json").read_bytes())["params"])
    restored = restore(fresh, backup)
    assert not restored.missing
    now = fresh.params.values()
    assert {name: now[name] for name in told} == told
    assert all(now[name] != defaults[name] for name in names_of(AWAY))
    assert bits(fresh) == EXPECTED["learned"]


def test_trial_files_with_speeds_from_elsewhere() -> None:
    (path,) = (FILES / "trials-with-speeds").glob("*.ulg")
    trial = read_trial(path)
    speeds = read_speeds(FILES / "speed.csv", len(trial.beats.samples), trial.beat_s)
    assert hexed(speeds.speed_m_s) == hexed(trial.beats.speed_m_s)


def test_speeds_of_a_film() -> None:
    cells = [row[1] for row in table(FILES / "track" / "beats.csv")[1]]
    speeds = read_speeds(FILES / "track" / "speed.csv", len(cells), 1.0)
    told = [float(cell or "nan") for cell in cells]
    np.testing.assert_array_equal(speeds.speed_m_s, np.array(told, np.float32))


def test_other_files(old: Path) -> None:
    calibration = json.loads((old / "tank.json").read_bytes())
    assert list(load_calibration(old / "tank.json").size_px) == calibration["size_px"]
    for name in ("identified.json", "identified-table.json"):
        document = json.loads((old / name).read_bytes())
        assert not missing(renamed(document), Identified.load(old / name).as_dict())
    assert len(read_steady_speeds(old / "steady.csv")[0]) == 5
    law, by_params = load(old / "law.json"), load(old / "law-params.json")
    assert (law.q_len, law.tail) == (by_params.q_len, by_params.tail) == (3, 2)
    assert len(from_csv(old / "reference.csv").speed_m_s) == 12
    keys, problems = KeyStore().load()
    assert problems == [] and [key.key for key in keys] == [bytes(range(1, 33))]
    assert decode_key((old / "fish.key").read_bytes(), "fish.key").key == keys[0].key


# Storage


def test_the_store_boots(stored: Fish, defaults: dict[str, float]) -> None:
    told, status = EXPECTED["store"], stored.status()
    assert (status.state, status.fault.name, status.next_trial) == ("IDLE", "NONE", 4)
    now = stored.params.values()
    wanted = params_of(told["params"])
    assert {name: now[name] for name in wanted} == wanted
    assert all(wanted[name] != defaults[name] for name in names_of(AWAY))
    assert set(AWAY) == {name for name in told["params"] if name.startswith(("LAW_", "GLIDE_"))}
    reference, learned = stored.reference_record(), stored.learned_record()
    assert reference is not None and reference.hex() == told["reference"]
    assert learned is not None and learned.hex() == told["learned"]
    assert bits(stored) == {name: told[name] for name in bits(stored)}
    for number, record in told["past"].items():
        assert (stored.past_record(f"/past{number}.bin") or b"").hex() == record


def test_no_entry_of_the_store_is_ignored() -> None:
    image = gzip.decompress((FILES / "store.bin.gz").read_bytes())
    params, ignored, whole = ffi.new("params_t *"), ffi.new("uint16_t *"), 0
    at = image.find(b"TBPA")
    while at >= 0:
        count = int.from_bytes(image[at + 6 : at + 8], "little")
        record = image[at : at + PARAM_HEADER_BYTES + PARAM_ENTRY_BYTES * count + CRC_BYTES]
        if lib.record_decode_params(ffi.from_buffer(record), len(record), params, ignored) == 0:
            whole += 1
            assert (ignored[0], count) == (0, len(EXPECTED["store"]["params"]))
        at = image.find(b"TBPA", at + 1)
    assert whole


def test_the_store_learns_on(stored: Fish) -> None:
    """By the moving average over trials that 0bf270a swam."""
    number = run_trial(stored).number
    stored.upload_speeds(number, [0.02, 0.05, 0.065, 0.06, 0.035], [0.001] * 5)
    stored.learn(number)
    assert bits(stored) == EXPECTED["store"]["after_one_more"]


def test_the_board_is_as_it_was_set(stored: Fish, old: Path, defaults: dict[str, float]) -> None:
    """By the library's meant.json."""
    assert not strayed(stored, None)
    meant = params_of({name: EXPECTED["store"]["params"][name] for name in AWAY})
    for name in meant:
        stored.params.set(name, defaults[name])
    found = strayed(stored, None)
    assert {name: found[name] for name in meant} == {
        name: (defaults[name], value) for name, value in meant.items()
    }
