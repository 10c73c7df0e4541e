"""reference upload --warm-start: what was learned goes along to a scaled reference."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tailbeat.app.cli import run
from tailbeat.board.fish import Fish
from tailbeat.board.snapshot import Snapshot
from tailbeat.core import reference as references
from tailbeat.core.errors import LinkLostError
from tailbeat.learning.fish_model import FishModel
from tailbeat.learning.transfer import similarity, transfer
from tailbeat.session.outcome import StopKind, StopReason
from tailbeat.session.transfer import plan, upload_transfer
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import SimBoard, SimTransport

OLD = "trapezoid:0.06,4,6"
SLOWER = "trapezoid:0.048,5,7.5"
QUIET = {"gain_sigma": 0, "flow_sigma_m_s": 0, "start_sigma_m_s": 0, "camera_noise_m": 0}
TANK = FishModel(
    *np.array([10.0, 0.219, 0.197, 0.3], np.float32).tolist()
)  # as the board's parameters
UPLOADED = 2


ENOUGH = StopReason(StopKind.CALLER, "enough")


@pytest.fixture
def simulated(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> SimBoard:
    """A board that stays between commands, with a trial library."""
    board = SimBoard("tank", **QUIET)
    monkeypatch.setattr("tailbeat.board.fish.open_transport", lambda url: SimTransport(board))
    monkeypatch.setenv("TAILBEAT_LOGBOOK", str(tmp_path / "logbook"))
    monkeypatch.chdir(tmp_path)
    return board


@pytest.fixture
def fish(simulated: SimBoard) -> Iterator[Fish]:
    with Fish.connect("the board") as connected:
        connected.params.set("ILC_LEAD", 1)
        yield connected


@pytest.fixture
def learned(fish: Fish) -> Fish:
    """Three trials along OLD."""
    fish.upload_reference(references.from_text(OLD).record())
    trial(fish, 3)
    return fish


def trial(fish: Fish, trials: int) -> list[float]:
    found = []
    for _ in range(trials):
        fish.arm()
        outcome = run_trial(fish)
        assert outcome.end == "complete"
        found.append(fish.learn(outcome.number).max_abs_error_m_s)
    return found


class Shell:
    """Commands on the board."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self.capsys = capsys

    def upload(self, new: str, *words: str) -> Any:
        line = ["reference", "upload", new, *words, "--connect", "the board"]
        assert run([*line, "--json"]) == 0, self.capsys.readouterr().err
        return json.loads(self.capsys.readouterr().out)

    def text(self, new: str, *words: str) -> tuple[str, str]:
        assert run(["reference", "upload", new, *words, "--connect", "the board"]) == 0
        out, err = self.capsys.readouterr()
        return out, err

    def fails(self, new: str, *words: str) -> str:
        assert run(["reference", "upload", new, *words, "--connect", "the board"]) == 1
        out, err = self.capsys.readouterr()
        assert (out, err.count("\n")) == ("", 1)
        return err


@pytest.fixture
def shell(capsys: pytest.CaptureFixture[str]) -> Shell:
    return Shell(capsys)


def expected(fish: Fish, amplitude: Any, new: str) -> np.ndarray[Any, Any]:
    old, wanted = references.from_text(OLD), references.from_text(new)
    limit = fish.params.get("AMP_MAX_RAD").value
    return transfer(amplitude, old, wanted, similarity(old, wanted), TANK, limit).amplitude_rad


def test_from_the_board(learned: Fish, shell: Shell) -> None:
    best, error = learned.amplitudes(best=True).values, learned.status().best_max_abs_error_m_s
    held = learned.learned_record()
    document = shell.upload(SLOWER, "--warm-start", "board")
    now = learned.amplitudes()
    np.testing.assert_array_equal(now.values, expected(learned, best, SLOWER))
    assert (now.iteration, now.input) == (1, UPLOADED)
    assert learned.status().reference_crc == references.from_text(SLOWER).crc
    like = document["like"]
    assert (like["magnitude"], like["time_factor"]) == pytest.approx((0.8, 0.8), rel=2e-3)
    assert like["old_max_abs_error_m_s"] == pytest.approx(error)
    assert (like["saturated_beats"], like["model"]) == (0, "board")
    assert like["expected_travel_m"] == pytest.approx(document["travel_m"], rel=2e-3)
    assert Snapshot.read(Path(document["copy"])).learned == held
    (first,) = trial(learned, 1)
    learned.params.set("ILC_GAIN", 6)  # or the first guess stays within the dead zone
    learned.upload_reference(references.from_text(OLD).record())
    learned.upload_reference(references.from_text(SLOWER).record())
    assert first < 0.5 * trial(learned, 1)[0]


def test_one_quiet_line(learned: Fish, shell: Shell) -> None:
    out, err = shell.text(SLOWER, "--warm-start", "board")
    assert err == ""
    assert out.count("\n") == 1
    assert "like the board, iteration 3 (max|e|" in out
    assert "speed times 0.8, time divided by 0.8, 0 beats saturated, expected travel 0.60 m" in out


def test_a_dry_run_changes_nothing(learned: Fish, shell: Shell, tmp_path: Path) -> None:
    before = learned.learned_record(), learned.reference_record()
    document = shell.upload(SLOWER, "--warm-start", "board", "--dry-run")
    assert document["copy"] is None
    out, err = shell.text(SLOWER, "--warm-start", "board", "--dry-run")
    rows = out.splitlines()
    assert rows[0] == "beat,amplitude_rad"
    values = np.array([float(row.split(",")[1]) for row in rows[1:]], np.float32)
    best = learned.amplitudes(best=True).values
    np.testing.assert_array_equal(values, expected(learned, best, SLOWER))
    assert values.tolist() == pytest.approx(document["like"]["amplitude_rad"])
    assert err.startswith("tailbeat: would upload")
    assert (learned.learned_record(), learned.reference_record()) == before
    assert not list((tmp_path / "logbook").glob("*/learned"))


def test_dry_run_alone_is_a_slip(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["reference", "upload", OLD, "--dry-run"]) == 2
    assert "--warm-start" in capsys.readouterr().err


def test_from_files(learned: Fish, shell: Shell, tmp_path: Path) -> None:
    """A trial, a folder of them, an experiment and a name: the best whole trial."""
    files = [learned.pull_trial(n, tmp_path / "trials") for n in (1, 2, 3)]
    best = learned.status().best_iteration
    assert best == 3
    words = ["experiment", "new", "--reference", OLD, "--connect", "the board"]
    assert run([*words, "--json"]) == 0
    folder = Path(json.loads(shell.capsys.readouterr().out)["folder"])
    from tailbeat.experiment.folder import Experiment

    for path in files:
        Experiment.open(folder).add_raw(path.name, path.read_bytes())
    amplitude = learned.amplitudes(best=True).values
    want = expected(learned, amplitude, SLOWER).tolist()
    learned.upload_reference(references.from_text("trapezoid:0.05,2,2").record())
    for like in (str(files[2]), str(tmp_path / "trials"), str(folder), OLD):
        found = shell.upload(SLOWER, "--warm-start", like, "--dry-run")["like"]
        assert found["amplitude_rad"] == want, like
        assert found["from"].startswith("trial 3 of")
        assert found["old_max_abs_error_m_s"] < 0.03
    other = shell.upload(SLOWER, "--warm-start", str(files[0]))["like"]
    assert other["from"] == "trial 1 of 0001.ulg"
    assert other["amplitude_rad"] != want


def test_by_name_from_the_board_and_the_library(learned: Fish, shell: Shell) -> None:
    assert shell.upload(SLOWER, "--warm-start", OLD, "--dry-run")["like"]["from"].startswith(
        "the board"
    )
    from tailbeat.experiment.library import library_of

    book = library_of(learned)
    assert book is not None
    book.keep(learned.pull_trial(2, book.folder / "x"))
    learned.upload_reference(references.from_text("trapezoid:0.05,2,2").record())
    found = shell.upload(SLOWER, "--warm-start", OLD)["like"]
    assert found["from"].startswith("trial 2 of this fish along trapezoid")
    assert "no whole trial" in shell.fails(SLOWER, "--warm-start", "thesis")


def test_another_shape_is_refused(learned: Fish, shell: Shell) -> None:
    before = learned.learned_record()
    error = shell.fails("cosine:0.048,5,7.5", "--warm-start", "board")
    assert "is no scaled copy" in error
    assert "5% are allowed" in error
    assert "leave out --warm-start" in error
    assert learned.learned_record() == before


def test_nothing_learned(fish: Fish, shell: Shell) -> None:
    assert "has learned nothing" in shell.fails(SLOWER, "--warm-start", "board")
    fish.upload_reference(references.from_text(OLD).record())
    fish.arm()  # which makes the first guess
    fish.disarm()
    assert fish.status().iteration == 1
    assert "has learned nothing" in shell.fails(SLOWER, "--warm-start", "board")
    assert fish.status().reference_crc == references.from_text(OLD).crc


def test_a_pending_trial_comes_first(learned: Fish, shell: Shell) -> None:
    learned.arm()
    assert "not IDLE" in shell.fails(SLOWER, "--warm-start", "board")
    run_trial(learned)
    assert "tailbeat trial learn, or tailbeat trial discard" in shell.fails(
        SLOWER, "--warm-start", "board"
    )


def test_a_cut_trial_is_not_a_whole_one(learned: Fish, shell: Shell, tmp_path: Path) -> None:
    learned.arm()
    outcome = run_trial(
        learned, guard=lambda seen: ENOUGH if getattr(seen, "beat", 0) > 6 else None
    )
    assert outcome.end.startswith("aborted")
    path = learned.pull_trial(outcome.number, tmp_path)
    learned.clear()
    learned.discard(outcome.number)
    assert "no whole trial" in shell.fails(SLOWER, "--warm-start", str(path))


@pytest.mark.parametrize("armed_between", [False, True])
def test_the_link_drops_between_the_uploads(
    learned: Fish, shell: Shell, monkeypatch: pytest.MonkeyPatch, armed_between: bool
) -> None:
    """Once more the same command: with what the board had learned before the first."""
    best = learned.amplitudes(best=True).values
    want = expected(learned, best, SLOWER)

    def lost(*_: object) -> None:
        raise LinkLostError("the board does not answer any more.", "Connect again.")

    with monkeypatch.context() as broken:
        broken.setattr(Fish, "upload_amplitudes", lost)
        shell.fails(SLOWER, "--warm-start", "board")
    assert learned.status().reference_crc == references.from_text(SLOWER).crc
    assert learned.status().iteration == 0
    if armed_between:
        learned.arm()
        learned.disarm()
    for _ in range(2):  # and it may be repeated when it is done
        document = shell.upload(SLOWER, "--warm-start", "board")
        assert document["like"]["from"].startswith("the copy ")
        assert document["copy"] is None
        np.testing.assert_array_equal(learned.amplitudes().values, want)
    trial(learned, 1)
    assert "has learned along" in shell.fails(SLOWER, "--warm-start", "board")


def test_a_copy_that_is_not_meant_is_not_taken(learned: Fish, shell: Shell) -> None:
    shell.upload(SLOWER, "--warm-start", "board")
    third = "trapezoid:0.045,5,7.5"
    learned.upload_reference(references.from_text(third).record())
    assert "there is no copy here" in shell.fails(third, "--warm-start", "board")


def test_the_copy_can_be_named_and_put_back(learned: Fish, shell: Shell) -> None:
    best, held = learned.amplitudes(best=True).values, learned.learned_record()
    copy = shell.upload(SLOWER, "--warm-start", "board")["copy"]
    learned.upload_reference(references.from_text("trapezoid:0.05,2,2").record())
    found = shell.upload(SLOWER, "--warm-start", copy)["like"]
    assert found["amplitude_rad"] == expected(learned, best, SLOWER).tolist()
    assert run(["board", "flash", "--restore", copy, "--connect", "the board"]) == 0
    shell.capsys.readouterr()
    assert learned.learned_record() == held


def test_there_and_back_again(learned: Fish, shell: Shell) -> None:
    """By 0.8 and by 1 / 0.8: nearly what it was, where the tail pushed."""
    best = learned.amplitudes(best=True).values
    shell.upload(SLOWER, "--warm-start", "board")
    document = shell.upload(OLD, "--warm-start", "board")
    back = np.array(document["like"]["amplitude_rad"], np.float32)
    pushed = (best > 0.25) & (back > 0.25)
    assert pushed.sum() >= 9
    assert np.abs(back - best)[pushed].max() < 0.02


def test_saturation_is_told(learned: Fish, shell: Shell) -> None:
    faster = "trapezoid:0.075,4,6"
    most = float(learned.amplitudes(best=True).values.max())
    learned.params.set("AMP_MAX_RAD", most)
    document = shell.upload(faster, "--warm-start", "board")
    like = document["like"]
    amplitude = np.array(like["amplitude_rad"], np.float32)
    assert amplitude.max() == np.float32(most)
    assert like["saturated_beats"] == np.count_nonzero(amplitude == np.float32(most)) > 3
    assert 0.7 * document["travel_m"] < like["expected_travel_m"] < 0.99 * document["travel_m"]


def test_too_fast_and_too_far(learned: Fish, shell: Shell, tmp_path: Path) -> None:
    before = learned.learned_record()
    learned.params.set("REF_MAX_M_S", 0.05)
    assert "the board allows 50.0" in shell.fails(
        OLD.replace("6,4", "7,4"), "--warm-start", "board"
    )
    learned.params.set("REF_MAX_M_S", 0.3)
    learned.params.set("TANK_LEN_M", 1.0)
    assert "the tank has 1.00 m" in shell.fails("trapezoid:0.07,4,6", "--warm-start", "board")
    path = learned.pull_trial(1, tmp_path)  # swam less than was wanted
    shell.upload("trapezoid:0.06,4.2,6.3", "--warm-start", str(path), "--dry-run")
    assert learned.learned_record() == before


def test_a_trial_that_swam_too_far_is_not_repeated(learned: Fish, monkeypatch: Any) -> None:
    """The reference fits; what its fish did, scaled, does not."""
    from dataclasses import replace

    from tailbeat.core.errors import InputError
    from tailbeat.session import transfer as upload

    found = upload.of_records(learned.reference_record(), learned.learned_record(), "the board")
    far = replace(found, travel_m=4.0)
    monkeypatch.setattr(upload, "of_records", lambda *_: far)
    wanted = references.from_text(SLOWER)
    with pytest.raises(
        InputError, match=r"would travel 4\.00 m, and the tank clearance is 2\.64 m"
    ):
        plan(learned, "board", wanted)
    learned.params.set("TANK_LEN_M", 0)
    assert plan(learned, "board", wanted).travel_m == pytest.approx(4.0, rel=2e-3)


def test_an_identified_fish_is_believed(learned: Fish, shell: Shell, tmp_path: Path) -> None:
    from tailbeat.learning.identification import Identified

    model = FishModel(5.0, 0.219, 0.15, 0.3)
    path = tmp_path / "fish.json"
    Identified(model, [model], np.eye(4)).save(path)
    line = ("trapezoid:0.06,5,7.5", "--warm-start", "board", "--dry-run")
    plain = shell.upload(*line)["like"]
    other = shell.upload(*line, "--identified", str(path))["like"]
    assert (plain["model"], other["model"]) == ("board", "identified")
    assert plain["amplitude_rad"] != other["amplitude_rad"]
    learned.params.set("MDL_SLOPE", 0)
    assert "MDL_SLOPE is 0" in shell.fails("trapezoid:0.06,5,7.5", "--warm-start", "board")


def test_without_a_library_nothing_is_kept(
    learned: Fish, monkeypatch: pytest.MonkeyPatch, shell: Shell
) -> None:
    monkeypatch.delenv("TAILBEAT_LOGBOOK")
    assert shell.upload(SLOWER, "--warm-start", "board")["copy"] is None
    assert learned.amplitudes().input == UPLOADED


def study(
    url: str, new: references.Reference, model: FishModel, learn: int, lead: int, **world: float
) -> tuple[float, list[float], float]:
    """(max|e| of the best along the thesis's profile, of a fresh start's trials along ``new``, of
    the first trial with what was learned)."""
    old = references.thesis()
    with Fish.connect(url, **world) as fish:
        wanted = {"AMP_MAX_RAD": math.pi / 4, "DU_MAX_RAD": 0, "TANK_LEN_M": 0, "ILC_LEAD": lead}
        names = ("MDL_KAPPA", "MDL_SLOPE", "MDL_DEAD_RAD", "MDL_DELAY_S")
        wanted |= dict(zip(names, list(vars(model).values())[:4], strict=True))
        for name, value in wanted.items():
            fish.params.set(name, value)
        fish.upload_reference(new.record())
        fresh = trial(fish, 4)
        fish.upload_reference(old.record())
        best = min(trial(fish, learn))
        upload_transfer(fish, plan(fish, "board", new))
        return best, fresh, trial(fish, 1)[0]


@pytest.mark.parametrize(
    ("speed", "duration_s"),
    [pytest.param(0.0791, 50, marks=pytest.mark.soak), (0.0791 * 1.25, 32)],
)
def test_the_first_trial_is_as_good_as_a_learned_one(speed: float, duration_s: float) -> None:
    """Measured 10.2 and 14.4 mm/s (its own floor); a fresh start 68.5, 29.9, 17.3, 11.6 and 73.3,
    27.3, 15.3, 14.2."""
    new = references.thesis(speed, duration_s)
    best, fresh, first = study("sim:tank?seed=1", new, TANK, 6, 1, **QUIET)
    print(best, fresh, first)
    assert first < 0.9 * fresh[2]
    assert first < fresh[3] + 0.001
    assert first < 0.016


def test_on_the_thesis_plant_it_is_an_approximation() -> None:
    """Its thrust is no power of amplitude less a dead zone. Measured 0.9 mm/s; a fresh start 35.2,
    13.8, 4.9, 1.8."""
    model = FishModel(414.264, 0.219, 0.0, 0.0)
    _, fresh, first = study("sim:thesis?seed=1", references.thesis(0.0791, 50), model, 6, 0)
    print(fresh, first)
    assert first < 0.004 < fresh[2]


@pytest.mark.soak
@pytest.mark.parametrize("kappa", [5, 10, 20])
def test_with_noise_it_saves_trials(kappa: float) -> None:
    """A model of another drag: the medians over ten fish."""
    new = references.thesis(0.0791 * 0.8, 50)
    seeds = range(1, 11)
    print("seeds", list(seeds))
    found = [study(f"sim:tank?seed={seed}", new, TANK, 7, 1, kappa_per_m=kappa) for seed in seeds]
    first = float(np.median([like for _, _, like in found]))
    fresh = np.median([trials for _, trials, _ in found], axis=0)
    print(first, fresh)
    assert first < 0.95 * fresh[2]
    assert first < 0.35 * fresh[0]
