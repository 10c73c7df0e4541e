"""Runs that identify a fish: planned within the tank, right in their numbers, and without a trace
on the board."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tailbeat.app.cli import run
from tailbeat.app.cli._operator import TerminalOperator
from tailbeat.app.cli._terminal import Display, json_asked
from tailbeat.app.cli.identify import RunView
from tailbeat.app.cli.info import _reference
from tailbeat.board import preserve
from tailbeat.board.fish import Fish
from tailbeat.board.snapshot import Snapshot
from tailbeat.core import reference
from tailbeat.core.arrays import F64
from tailbeat.core.errors import InputError, LinkLostError, TailbeatError
from tailbeat.core.records import record_crc
from tailbeat.core.speed_source import Frame
from tailbeat.learning.error_bound_solve import plant_beats, plant_config
from tailbeat.learning.fish_model import Conditions, FishModel, TrialSpeeds
from tailbeat.learning.fit import Prior
from tailbeat.learning.fit_quality import account_of, from_trials
from tailbeat.learning.identification_runs import (
    IdentificationRun,
    IdentificationSeries,
    Limits,
    identify_runs,
)
from tailbeat.link.messages import BeatEvent, Event
from tailbeat.session.identify import IdentificationHooks, identify_fish, set_params
from tailbeat.session.outcome import StopKind, StopReason
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import SimBoard, SimTransport

Array = F64

COAST = np.zeros(5)
SIGMA_M_S = 0.0007  # of a beat, by a camera of 25 pictures a second and 1 mm
NO_SERVO = {"servo_lag_s": 0.0, "servo_rate_rad_s": 0.0}


class Pond:
    """The simulator's tank plant, swum without a board; what differs from swim to swim is drawn
    here."""

    def __init__(self, seed: int | None, noise: float = 1.0, **fish: float) -> None:
        self.fish, self.noise = fish, noise if seed is not None else 0.0
        self.rng = np.random.default_rng(seed)
        self.slope = fish.get("slope_m_s_rad", 0.219)
        self.ways_m: list[float] = []

    def __call__(self, amplitude: Array) -> TrialSpeeds:
        gain, flow = self.rng.normal(0, [0.02, 0.0015]) * self.noise
        config = plant_config("tank", self.fish | {"slope_m_s_rad": self.slope * (1 + gain)})
        speed = plant_beats(config, np.r_[amplitude, COAST], 1.0) + flow
        self.ways_m.append(float(speed.sum()))
        speed = speed[: len(amplitude)]
        speed += self.rng.normal(0, SIGMA_M_S, len(speed)) * self.noise
        return TrialSpeeds(amplitude, speed, np.full(len(speed), SIGMA_M_S))


@pytest.mark.parametrize("kappa", [5.0, 10.0, 20.0])
def test_the_truth_is_inside_the_intervals(kappa: float) -> None:
    """Without a servo the plant's own numbers are the model's."""
    truth = {"kappa_per_m": kappa, "slope_m_s_rad": 0.219, "dead_zone_rad": 0.197, "delay_s": 0.3}
    inside = dict.fromkeys(truth, 0)
    errors: dict[str, list[float]] = {name: [] for name in truth}
    for seed in range(1, 21):
        pond = Pond(seed, kappa_per_m=kappa, **NO_SERVO)
        found = identify_runs(pond, Limits(math.pi / 4), quick=True)
        straight = found.model.straight(math.pi / 4)
        for name, true in truth.items():
            low, high = found.band[name]
            inside[name] += low <= true <= high
            errors[name].append(getattr(straight, name) / true - 1)
        assert max(pond.ways_m) < 3.0 - 0.36
    assert min(inside.values()) >= 18, inside
    median = {name: abs(float(np.median(e))) for name, e in errors.items()}
    assert median["kappa_per_m"] < 0.04
    assert median["slope_m_s_rad"] < 0.02  # of the line through the map, which may be bent
    assert median["dead_zone_rad"] < 0.02
    assert median["delay_s"] < 0.15


def test_with_bootstrap_and_servo() -> None:
    """A servo takes 3 % off the amplitude: slope and dead zone are those the fish shows."""
    config = plant_config("tank", {"kappa_per_m": 10.0})
    amplitude = np.linspace(0.3, 0.78, 5)
    steady = [plant_beats(config, np.full(60, u), 1.0)[-1] for u in amplitude]
    slope, offset = np.polyfit(amplitude, steady, 1)
    found = identify_runs(Pond(3, kappa_per_m=10.0), Limits(math.pi / 4))
    assert len(found.models) == 100
    for name, true in {
        "kappa_per_m": 10.0, "slope_m_s_rad": slope, "dead_zone_rad": -offset / slope,
        "delay_s": 0.32,
    }.items():  # fmt: skip
        low, high = found.band[name]
        assert low < true < high, name


@pytest.mark.parametrize("tank_m", [1.3, 3.0])
@pytest.mark.parametrize("most_rad", [0.5, math.pi / 4])
def test_never_beyond_the_tank(tank_m: float, most_rad: float) -> None:
    """Fish that are faster, or coast farther, than anyone expects."""
    for kappa, slope, dead in product((4.0, 28.0), (0.85, 1.15), (0.7, 1.3)):
        fish = {"slope_m_s_rad": 0.219 * slope, "dead_zone_rad": 0.197 * dead}
        pond = Pond(None, kappa_per_m=kappa, **fish)
        limits = Limits(most_rad, tank_m=tank_m)
        runs: list[IdentificationRun] = []
        identify_runs(pond, limits, on_run=runs.append, quick=True)
        assert 4 <= len(runs) <= 6  # in a short tank the first may be too gentle to move it
        for one, way_m in zip(runs, pond.ways_m, strict=True):
            assert one.travel_m <= one.travel_worst_m <= limits.usable_m + 1e-9
            assert way_m < tank_m - limits.fish_m
            assert one.amplitude_rad.max() <= most_rad


def test_the_pessimistic_edge_is_where_it_says() -> None:
    """Of fish drawn from what is believed before the first run, 2.3 % may go farther."""
    first = IdentificationSeries(Limits(math.pi / 4)).next_run()
    rng = np.random.default_rng(5)
    prior = Prior()
    ways = []
    for kappa, slope, dead, delay, gain, flow in rng.standard_normal((1500, 6)):
        model = FishModel(
            prior.model.kappa_per_m * math.exp(prior.kappa * kappa),
            prior.model.slope_m_s_rad * math.exp(prior.slope * slope),
            max(prior.model.dead_zone_rad + prior.dead_zone_rad * dead, 0),
            max(prior.model.delay_s + prior.delay_s * delay, 0),
        )
        today = Conditions(gain=1 + 0.02 * gain, flow_m_s=0.0015 * flow)
        ways.append(model.beats(np.r_[first.amplitude_rad, COAST], 1.0, today).sum())
    assert 0.01 < np.mean(np.array(ways) > first.travel_worst_m) < 0.05


def test_gentlest_first_and_later_ones_know_more() -> None:
    runs: list[IdentificationRun] = []
    identify_runs(Pond(1, kappa_per_m=10.0), Limits(math.pi / 4), on_run=runs.append, quick=True)
    assert [one.kind for one in runs] == ["cruise", "cruise", "cruise", "coast-down"]
    tops = [one.cruise_rad for one in runs]
    assert tops == sorted(tops)
    assert tops[2] == pytest.approx(math.pi / 4)
    doubt = [one.travel_worst_m / one.travel_m for one in runs]
    assert doubt[0] > 2
    assert max(doubt[1:]) < 1.2
    for one in runs:  # gentle steps up, then no thrust to the end
        thrust = np.maximum(one.amplitude_rad - 0.2, 0)
        assert np.diff(thrust).max() < 0.15
        assert np.all(one.amplitude_rad[-7:] == 0)


def test_a_fast_fish_is_slowed_down() -> None:
    def tops(slope: float) -> list[float]:
        runs: list[IdentificationRun] = []
        pond = Pond(1, kappa_per_m=10.0, slope_m_s_rad=slope)
        identify_runs(pond, Limits(math.pi / 4), on_run=runs.append, quick=True)
        assert max(pond.ways_m) < 2.64
        return [one.travel_m for one in runs] + [one.cruise_rad for one in runs]

    slow, fast = tops(0.219), tops(0.6)
    assert fast[0] == slow[0]  # nobody knew yet
    assert fast[6] < slow[6]


def test_the_step_limit() -> None:
    runs: list[IdentificationRun] = []
    limits = Limits(math.pi / 4, step_max_rad=0.1)
    identify_runs(Pond(1, kappa_per_m=10.0), limits, on_run=runs.append, quick=True)
    tops = np.array([one.cruise_rad for one in runs])
    assert np.diff(tops).max() <= 0.1 + 1e-12
    assert np.diff(tops)[0] == pytest.approx(0.1)


def test_where_nothing_moves_the_next_run_is_stronger() -> None:
    runs: list[IdentificationRun] = []
    pond = Pond(2, kappa_per_m=10.0, dead_zone_rad=0.5, **NO_SERVO)
    found = identify_runs(pond, Limits(math.pi / 4), on_run=runs.append, quick=True)
    still = [one for one, way in zip(runs, pond.ways_m, strict=True) if way < 0.1]
    assert still and len(runs) == 4 + len(still)
    assert runs[len(still)].cruise_rad > still[-1].cruise_rad
    assert found.model.dead_zone_rad == pytest.approx(0.5, abs=0.03)


def test_a_fish_that_never_moves() -> None:
    pond = Pond(2, kappa_per_m=10.0, dead_zone_rad=0.9)
    with pytest.raises(InputError, match=r"did not move at 0\.50 rad"):
        identify_runs(pond, Limits(0.5), quick=True)
    assert len(pond.ways_m) <= 8


def test_a_tank_that_is_too_short() -> None:
    with pytest.raises(InputError, match="too short"):
        identify_runs(Pond(1), Limits(0.5, tank_m=0.6), quick=True)


def test_speeds_that_nobody_measured() -> None:
    def blind(amplitude: Array) -> TrialSpeeds:
        return TrialSpeeds(
            amplitude, np.full(len(amplitude), np.nan), np.full(len(amplitude), 0.001)
        )

    with pytest.raises(InputError, match="identification trial 1 has no speeds"):
        identify_runs(blind, Limits(0.5), quick=True)


# -- on a board -----------------------------------------------------------------------------------


@pytest.fixture
def board() -> SimBoard:
    return SimBoard("tank", seed=4)


@pytest.fixture
def tank(board: SimBoard) -> Iterator[Fish]:
    with Fish(SimTransport(board)) as fish:
        fish.clock.sync()
        yield fish


@pytest.fixture
def learned(tank: Fish) -> Fish:
    """A fish that has learned from two trials of eight beats."""
    tank.upload_reference(reference.cosine(0.06, 3, 2))
    for _ in range(2):
        run_trial(tank)
        tank.learn()
    return tank


def state(fish: Fish) -> dict[str, Any]:
    status = fish.status()
    best = fish.amplitudes(best=True)
    return {
        "reference": fish.reference_record(),
        "amplitudes": fish.amplitudes().values.tobytes(),
        "best": best.values.tobytes(),
        "status": [
            status.state, status.iteration, status.best_iteration, status.pending_trial,
            status.best_max_abs_error_m_s, status.worse_streak,
        ],
        "params": fish.params.values(),
    }  # fmt: skip


def test_the_board_has_everything_back(learned: Fish, tmp_path: Path) -> None:
    before = state(learned)
    files: list[Path] = []

    def keep(path: Path) -> None:
        files.append(Path(shutil.copy(path, tmp_path)))

    found = identify_fish(learned, IdentificationHooks(keep=keep), tmp_path / "safe", quick=True)
    assert state(learned) == before
    assert not (tmp_path / "safe").exists()
    assert found.unique_id == learned.unique_id()
    assert len(files) == 4
    # The files tell the same fish, by the prior of any fish and not the board's.
    again, simulated = from_trials(files)
    assert simulated
    assert again.model.kappa_per_m == pytest.approx(found.model.kappa_per_m, rel=0.03)
    speeds = again.model.steady_m_s([0.3, 0.4, 0.5])
    assert speeds == pytest.approx(found.model.steady_m_s([0.3, 0.4, 0.5]), rel=0.02)
    assert again.alpha_kg_m is not None
    account = account_of(found)
    assert account.rms_m_s < 0.0015
    assert account.battery_v == pytest.approx((8.2, 8.2), abs=0.3)
    assert all(trial.way_m < 2.64 for trial in account.trials)


def failing(calls: int, error: BaseException) -> Callable[..., Any]:
    left = [calls]

    def fail(*_: Any) -> None:
        left[0] -= 1
        if left[0] == 0:
            raise error

    return fail


@pytest.mark.parametrize("error", [KeyboardInterrupt(), TailbeatError("x", "y")])
@pytest.mark.parametrize("where", ["before", "keep", "event"])
def test_after_a_failure_too(
    learned: Fish, board: SimBoard, tmp_path: Path, where: str, error: BaseException
) -> None:
    before = state(learned)
    calls = 70 if where == "event" else 2
    with pytest.raises(type(error)):
        identify_fish(
            learned,
            IdentificationHooks(**{where: failing(calls, error)}),
            tmp_path / "safe",
            quick=True,
        )
    assert state(learned) == before
    assert where != "event" or len(board.world.true_beats()) < 20  # the tail stopped at once


def test_stopped_by_hand_in_a_beat(learned: Fish, board: SimBoard) -> None:
    """At once, not with the next beat; nothing is fitted to half a run."""
    before = state(learned)
    pressed: list[Event] = []

    def event(event: Event) -> None:
        if isinstance(event, BeatEvent) and event.beat == 3:
            pressed.append(event)

    attendant = IdentificationHooks(event=event, wants_abort=lambda: bool(pressed))
    with pytest.raises(TailbeatError, match="identification trial 1 was stopped by hand"):
        identify_fish(learned, attendant, quick=True)
    assert state(learned) == before
    assert len(board.world.true_beats()) <= 6


def test_the_wall_guard_is_asked(learned: Fish) -> None:
    """What it stops has told enough, and the next run is executed."""
    seen: list[object] = []
    beats: list[BeatEvent] = []
    runs: list[IdentificationRun] = []

    def guard(what: object) -> StopReason | None:
        seen.append(what)
        if isinstance(what, BeatEvent):
            beats.append(what)
        return (
            StopReason(StopKind.WALL, "wall: 0.2 m left")
            if len(runs) == 1 and len(beats) >= 20
            else None
        )

    identified = identify_fish(
        learned, IdentificationHooks(before=runs.append, guard=guard), quick=True
    )
    assert any(isinstance(one, Frame) for one in seen)
    assert len(runs) == 4 and len(identified.trials) == 4
    first = identified.trials[0]
    assert first.swum_beats is not None and first.swum_beats < runs[0].beats


def test_when_the_link_stays_away_a_copy_is_left(
    learned: Fish, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = state(learned)
    record = learned.learned_record()
    monkeypatch.setattr(preserve, "_restore", failing(1, LinkLostError("gone", "")))
    with pytest.raises(TailbeatError, match=r"a copy is in .*flash --restore"):
        identify_fish(learned, IdentificationHooks(), tmp_path / "safe", quick=True)
    copy = Snapshot.read(tmp_path / "safe")
    assert (copy.reference, copy.learned) == (before["reference"], record)


class Killed(BaseException):
    """As by kill -9: nothing is put back."""


@pytest.fixture
def killed(learned: Fish, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Fish:
    """A computer died in the second run; its trial is pending, the copy lies in ``safe``."""
    with monkeypatch.context() as patch:
        patch.setattr(preserve, "_put_back", lambda *_: None)
        with pytest.raises(Killed):
            identify_fish(
                learned,
                IdentificationHooks(keep=failing(2, Killed())),
                tmp_path / "safe",
                quick=True,
            )
    return learned


def test_after_a_computer_died_the_first_copy_is_put_back(
    learned: Fish, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    before = state(learned)
    fish = request.getfixturevalue("killed")
    assert fish.status().pending_trial is not None
    heard: list[str] = []
    identify_fish(fish, IdentificationHooks(note=heard.append), tmp_path / "safe", quick=True)
    assert state(fish) == before
    assert len(heard) == 1 and "was interrupted" in heard[0] and str(tmp_path / "safe") in heard[0]
    assert list(tmp_path.iterdir()) == []


def test_without_another_swim_it_is_put_back_too(
    learned: Fish, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """By 'session resume'; the run that waits on the board goes."""
    before = state(learned)
    fish = request.getfixturevalue("killed")
    trials = len(fish.trials())
    heard: list[str] = []
    assert preserve.restore_interrupted(fish, tmp_path / "safe", heard.append)
    assert state(fish) == before and len(fish.trials()) == trials
    assert len(heard) == 1 and "gets back" in heard[0]
    assert not (tmp_path / "safe").exists()
    assert (
        not preserve.restore_interrupted(fish, tmp_path / "safe", heard.append) and len(heard) == 1
    )


def test_a_trial_is_no_run_after_all(learned: Fish, tmp_path: Path) -> None:
    """A copy that lies there says nothing while the board has its own reference."""
    run_trial(learned)
    before = state(learned)
    preserve._write_copy(tmp_path / "safe", preserve._held(learned, {}, ()), print)
    assert not preserve.restore_interrupted(learned, tmp_path / "safe", print)
    assert state(learned) == before


def test_a_computer_that_died_while_putting_back(
    learned: Fish, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    before = state(learned)
    fish = request.getfixturevalue("killed")
    fish.discard()
    fish.upload_reference(before["reference"])  # what was learned did not follow
    identify_fish(fish, IdentificationHooks(), tmp_path / "safe", quick=True)
    assert state(fish) == before


def test_an_older_copy_neither_comes_back_nor_goes(
    learned: Fish, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    fish = request.getfixturevalue("killed")
    copy = Snapshot.read(tmp_path / "safe")
    fish.discard()
    assert copy.reference is not None and copy.learned is not None
    fish.upload_reference(copy.reference)  # as flash --restore does
    fish.upload_learned(copy.learned)
    run_trial(fish)
    fish.learn()
    before = state(fish)
    heard: list[str] = []
    identify_fish(fish, IdentificationHooks(note=heard.append), tmp_path / "safe", quick=True)
    assert state(fish) == before
    assert Snapshot.read(tmp_path / "safe-1") == copy
    assert str(tmp_path / "safe-1") in heard[0]


def test_a_guess_is_made_anew(tank: Fish) -> None:
    """Amplitudes that arming made of the reference stay what arming makes, by the gain then."""
    tank.params.set("ILC_LEAD", 0)
    tank.upload_reference(reference.cosine(0.06, 3, 2))
    tank.arm()
    tank.disarm()
    assert tank.status().iteration == 1
    identify_fish(tank, IdentificationHooks(), quick=True)
    assert tank.status().iteration == 0
    tank.params.set("ILC_GAIN", 5.0)
    tank.arm()
    held = tank.amplitudes().values
    wanted = reference.cosine(0.06, 3, 2).speed_m_s
    assert held == pytest.approx(5.0 * wanted, rel=1e-6)


def test_no_reference_before_and_no_run_after(tank: Fish) -> None:
    identify_fish(tank, IdentificationHooks(), quick=True)
    status = tank.status()
    assert (status.iteration, status.beats, status.pending_trial) == (0, 1, None)
    assert _reference(status).startswith("none; upload one")


def test_refused_while_a_trial_is_pending(learned: Fish) -> None:
    run_trial(learned)
    before = state(learned)
    with pytest.raises(InputError, match="trial 3 is neither learned nor discarded"):
        identify_fish(learned, IdentificationHooks())
    assert state(learned) == before


def test_speeds_by_hand(tank: Fish, board: SimBoard) -> None:
    tank.params.set("SPD_SOURCE", 1)
    with pytest.raises(InputError, match="SPD_SOURCE is upload"):
        identify_fish(tank, IdentificationHooks())

    def by_video(trial: int, beats: int, beat_s: float) -> Array:
        del trial, beat_s
        return board.world.true_beats()[:beats]

    found = identify_fish(tank, IdentificationHooks(speeds=by_video), quick=True)
    assert found.model.kappa_per_m == pytest.approx(10, rel=0.15)


def test_parameters_last_and_others_do_not(learned: Fish, board: SimBoard) -> None:
    found = identify_fish(learned, IdentificationHooks(), quick=True)
    learned.params.set("ILC_GAIN", 5.5)
    held = set_params(learned, found)
    assert held["MDL_KAPPA"] == pytest.approx(found.model.kappa_per_m, rel=1e-6)
    assert learned.params.get("ILC_GAIN").value == 5.5
    board.world.power_cycle()
    learned.link.run(2.0)
    for name, value in held.items():
        assert learned.params.get(name).value == value
    assert learned.params.get("ILC_GAIN").value == 4.0


@pytest.mark.painted
def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture, file = tmp_path / "fish.png", tmp_path / "fish.json"
    line = [
        "session",
        "identify",
        "--connect",
        "sim:tank?seed=3",
        "--out",
        str(file),
        "--plot",
        str(picture),
    ]
    assert run([*line, "--json"]) == 0
    out, err = capsys.readouterr()
    found = json.loads(out)
    assert err == ""
    assert found["source"] == "runs"
    assert set(found["params"]) == {"MDL_KAPPA", "MDL_SLOPE", "MDL_DEAD_RAD", "MDL_DELAY_S"}
    assert found["band"]["kappa_per_m"][0] < 10 < found["band"]["kappa_per_m"][1]
    assert found["saved"] == [str(file)]
    assert [one["trial"] for one in found["runs"]] == [1, 2, 3, 4]
    assert all(one["way_m"] < 2.64 for one in found["runs"])
    assert found["runs"][0]["battery_v"] == pytest.approx(8.2, abs=0.3)
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert json.loads(file.read_text())["model"] == found["model"]


def test_a_real_fish_waits_for_somebody(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tailbeat.link.messages.SIMULATED_FISH", ())
    line = ["session", "identify", "--connect", "sim:tank?seed=3", "--library", str(tmp_path)]
    assert run([*line, "--json"]) == 1
    assert "Add --yes" in capsys.readouterr().err
    asked: list[str] = []
    monkeypatch.setattr("typer.prompt", lambda text, **_: asked.append(text))
    assert run(line) == 0
    out, err = capsys.readouterr()
    assert len(asked) == 4
    assert "identification trial 1, cruise: 28 beats, up to 0.32 rad (18 degrees)" in err
    kept = sorted(path.name for path in tmp_path.rglob("*.ulg"))
    assert len(kept) == 4
    assert "the board has no reference yet" in out
    assert len(list(tmp_path.rglob("*.run"))) == 4
    assert f"saved in {next(tmp_path.rglob('identified.json'))}" in out
    assert not list(tmp_path.rglob("before-identify"))


@pytest.mark.parametrize("with_json", [False, True])
def test_a_run_is_announced_but_not_with_json(
    capsys: pytest.CaptureFixture[str], with_json: bool
) -> None:
    """A simulated fish waits for nobody."""
    still = np.zeros(3)
    view = RunView(Limits(0.75), TerminalOperator(Display(), None), lambda *_: None)
    asked = json_asked.set(with_json)
    view.before(IdentificationRun(1, "cruise", 0.3, still, still, 0.2, 0.4))
    json_asked.reset(asked)
    err = capsys.readouterr().err
    assert (
        err == ""
        if with_json
        else err.startswith("identification trial 1, cruise: 3 beats, up to 0.30 rad")
    )


@pytest.mark.parametrize("yes", [False, True])
def test_speeds_that_are_uploaded_are_asked_for(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    board: SimBoard,
    yes: bool,
) -> None:
    """Again, until a file fits; never with --yes."""
    monkeypatch.setattr("tailbeat.board.fish.open_transport", lambda url: SimTransport(board))
    with Fish.connect("sim") as fish:
        fish.params.set("SPD_SOURCE", 1)
    speeds = tmp_path / "speeds.csv"
    asked: list[str] = []

    def answer(question: str) -> str:
        asked.append(question)
        if len(asked) == 1:
            return str(tmp_path / "none.csv")
        rows = enumerate(board.world.true_beats())
        speeds.write_text("beat,speed_m_s\n" + "\n".join(f"{k},{v}" for k, v in rows))
        return str(speeds)

    monkeypatch.setattr("tailbeat.app.cli.identify.typer.prompt", answer)
    status = run(["session", "identify", "--connect", "sim", *(["--yes"] if yes else [])])
    err = capsys.readouterr().err
    if yes:
        assert status == 1 and "nobody is asked for the speeds" in err and not asked
        return
    assert status == 0, err
    assert "none.csv" in err and "Speeds of trial 1 (CSV" in asked[0]
    assert len(asked) == 5


def test_files_of_two_fish_do_not_mix(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = []
    for seed in (1, 2):
        with Fish.connect(f"sim:tank?seed={seed}") as fish:
            fish.upload_reference(reference.cosine(0.06, 3, 2))
            outcome = run_trial(fish)
            (tmp_path / str(seed)).mkdir()
            paths.append(str(fish.pull_trial(outcome.number, tmp_path / str(seed))))
    assert run(["session", "identify", "--trials", *paths]) == 1
    assert "2 different boards" in capsys.readouterr().err
    assert run(["session", "identify", "--trials", paths[0], "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["source"], found["saved"]) == ("trials", [])
    assert found["warnings"]  # one short trial tells little


def test_references_of_runs_are_told_apart() -> None:
    runs: list[IdentificationRun] = []
    identify_runs(Pond(1, kappa_per_m=10.0), Limits(0.5), on_run=runs.append, quick=True)
    crcs = {
        record_crc(reference.Reference(1.0, one.predicted_m_s.astype(np.float32), "").record())
        for one in runs
    }
    assert len(crcs) == len(runs)
