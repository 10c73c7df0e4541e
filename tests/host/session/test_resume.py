"""After a battery swap: what the board gets back, and what one repeat of the best says of the fish.

The boards live in this process, in virtual time. ``Pool`` swims one short series; every test gets a
copy of its board's flash, its experiment and its trial library.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tailbeat.app.cli import _kept
from tailbeat.app.cli._terminal import Display
from tailbeat.app.cli.session import _operator
from tailbeat.board import preserve
from tailbeat.board.fish import Fish
from tailbeat.board.snapshot import Snapshot
from tailbeat.core import records, reference
from tailbeat.core.errors import InputError, TailbeatError
from tailbeat.experiment.current import begin, current, is_interrupted, note_set, strayed, use
from tailbeat.experiment.folder import Experiment, copy_state, held_state
from tailbeat.link.messages import BeatEvent, LearnReport
from tailbeat.session.change import FishChange, change_of
from tailbeat.session.collect import keep_log, outcome_of, record_of
from tailbeat.session.events import Event, TrialStarted
from tailbeat.session.identify import prior_of
from tailbeat.session.log import SessionLog, repeat_path, write_held
from tailbeat.session.options import Options, Until
from tailbeat.session.outcome import Decision, RecordedTrial
from tailbeat.session.resume import Restored, repeat_best, restore
from tailbeat.session.series import run_series
from tailbeat.session.trial import run_trial
from tailbeat.session.trim import find_centre
from tailbeat.sim.board import SimBoard, SimTransport

from ..conftest import BadRadio

WANTED = reference.trapezoid(0.06, 5, 8)
PARAMS = {"AMP_MAX_RAD": 0.7, "DU_MAX_RAD": 0.0, "ILC_LEAD": 1.5, "ROLLBACK_RATIO": 1.5}
ONE = Options(until=Until(1), wanted=None)
SEED = 3


class Somebody:
    """Keeps everything that was told, and says what was asked for."""

    def __init__(self, *decisions: Decision) -> None:
        self.events: list[Event] = []
        self.decisions = list(decisions)

    def tell(self, event: Event) -> None:
        self.events.append(event)

    def wants_abort(self) -> bool:
        return False

    def decide(self, recorded: RecordedTrial) -> Decision:
        return self.decisions.pop(0) if self.decisions else Decision("keep")

    def confirm(self, question: str) -> bool:
        return True

    def number(self, question: str, value: float) -> float | None:
        return value

    def count(self, kind: type) -> int:
        return sum(isinstance(event, kind) for event in self.events)


class Pool:
    """A fish with four trials behind it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        board = SimBoard("tank", seed=SEED)
        fish = connect(board)
        for name, value in PARAMS.items():
            fish.params.set(name, value)
        fish.upload_reference(WANTED)
        self.experiment = begin(fish, folder / "experiments").folder
        run_series(fish, Experiment(self.experiment), Somebody(), Options(Until(3), None))
        self.younger = board.flash
        run_series(fish, Experiment(self.experiment), Somebody(), ONE)
        self.flash = board.flash
        self.learned = fish.learned_record()


def connect(board: SimBoard) -> Fish:
    fish = Fish(SimTransport(board))
    fish.clock.sync()
    return fish


@pytest.fixture(scope="module")
def pool(tmp_path_factory: pytest.TempPathFactory) -> Pool:
    print(f"seed {SEED}")
    folder = tmp_path_factory.mktemp("pool")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TAILBEAT_LOGBOOK", str(folder / "logbook"))
        return Pool(folder)


@pytest.fixture
def experiment(pool: Pool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Experiment:
    shutil.copytree(pool.folder / "logbook", tmp_path / "logbook")
    monkeypatch.setenv("TAILBEAT_LOGBOOK", str(tmp_path / "logbook"))
    return Experiment(Path(shutil.copytree(pool.experiment, tmp_path / pool.experiment.name)))


@pytest.fixture
def swapped(pool: Pool) -> Fish:
    """Switched off and on with another battery: what was not saved is gone."""
    return after_a_swap(pool.flash)


def after_a_swap(flash: bytes, seed: int = SEED, gain: float = 1.0) -> Fish:
    board = SimBoard("tank", seed=seed)
    board.flash = flash
    board.world.swap_battery(8.3, gain=gain)
    board.world.set_swim(9)  # the water and the fish of another hour
    board.run(1.0)
    return connect(board)


def values(fish: Fish) -> dict[str, float]:
    return fish.params.values(*PARAMS)


def as_float32(params: dict[str, float]) -> dict[str, float]:
    return {name: float(np.float32(value)) for name, value in params.items()}


# What is given back


def test_parameters_that_were_not_saved_are_given_back_and_saved(
    swapped: Fish, experiment: Experiment, pool: Pool
) -> None:
    assert values(swapped) != as_float32(PARAMS)  # they were lost
    found = restore(swapped, experiment)
    assert found.params == as_float32(PARAMS)
    assert (found.reference, found.learned, found.iteration) == (False, False, 5)
    assert found.battery_v == pytest.approx(8.3, abs=0.05)
    board = swapped.sim
    assert board is not None
    board.world.power_cycle()
    board.run(1.0)
    again = connect(board)  # type: ignore[arg-type]
    assert values(again) == as_float32(PARAMS)
    assert again.learned_record() == pool.learned
    assert restore(again, experiment).params == {}


def test_a_board_that_lost_everything_gets_everything(experiment: Experiment, pool: Pool) -> None:
    fish = after_a_swap(SimBoard("tank", seed=SEED).flash)
    assert fish.status().reference_crc is None
    found = restore(fish, experiment)
    assert found.reference and found.learned and found.iteration == 5
    assert fish.learned_record() == pool.learned
    assert fish.status().reference_crc == WANTED.crc
    assert values(fish) == as_float32(PARAMS)
    entry = experiment.journal.entries("resumed")[-1]
    assert entry["learned"] is True and entry["iteration"] == 5


def test_a_board_that_is_behind_comes_up(experiment: Experiment, pool: Pool) -> None:
    fish = after_a_swap(pool.younger)
    assert fish.status().iteration == 4
    found = restore(fish, experiment)
    assert found.learned and not found.reference
    assert fish.learned_record() == pool.learned


def test_a_board_that_is_ahead_keeps_what_it_has(
    swapped: Fish, experiment: Experiment, pool: Pool
) -> None:
    """Learned without the tool that keeps the copy."""
    run_trial(swapped)
    swapped.learn()
    ahead = swapped.learned_record()
    found = restore(swapped, experiment)
    assert not found.learned and found.iteration == 6
    assert "learned more than the copy" in found.notes[0]
    assert swapped.learned_record() == ahead != pool.learned
    held = held_state(experiment)
    assert held is not None and held.learned == ahead


def test_amplitudes_that_somebody_uploaded_stay(swapped: Fish, experiment: Experiment) -> None:
    """As old as the copy, but others."""
    swapped.upload_amplitudes(np.full(WANTED.beats, 0.4))
    mine = swapped.learned_record()
    found = restore(swapped, experiment)
    assert not found.learned and "the board's stay" in found.notes[0]
    assert swapped.learned_record() == mine


def test_two_that_learned_apart_are_not_mixed(experiment: Experiment, pool: Pool) -> None:
    """The copy is of trial 4; the board was made anew and has learned its own trials 1 to 6."""
    record = bytearray(pool.learned or b"")
    fish = after_a_swap(pool.younger)
    mine = records.decode_learned(bytes(record))
    assert mine.iteration == 5
    apart = _record_with(bytes(record), last_trial=2, iteration=9)
    fish.upload_learned(apart)
    with pytest.raises(InputError, match="both learned, separately"):
        restore(fish, experiment)
    assert fish.learned_record() == apart
    held = held_state(experiment)
    assert held is not None and held.learned == pool.learned


def _record_with(record: bytes, last_trial: int, iteration: int) -> bytes:
    """Fields of docs/reference/protocol.md, TBLM: last trial at 16, iteration at 20."""
    body = bytearray(record[12:])
    body[4:8] = last_trial.to_bytes(4, "little")
    body[8:10] = iteration.to_bytes(2, "little")
    head = record[:8]
    return head + records.crc32(head + bytes(body)).to_bytes(4, "little") + bytes(body)


def test_another_fish_is_refused_and_left_alone(experiment: Experiment) -> None:
    other = after_a_swap(SimBoard("tank", seed=77).flash, seed=77)
    with pytest.raises(InputError, match="another fish") as error:
        restore(other, experiment)
    assert "\n" not in str(error.value) and "--another-board" in str(error.value)
    assert other.status().reference_crc is None
    assert experiment.journal.entries("resumed") == []


def test_a_replaced_board_takes_the_others_place(experiment: Experiment, pool: Pool) -> None:
    new = after_a_swap(SimBoard("tank", seed=77).flash, seed=77)
    assert restore(new, experiment, another_board=True).learned
    assert new.learned_record() == pool.learned
    assert not restore(new, experiment).learned  # it is the experiment's now
    found = current(new)
    assert found is not None and found.folder == experiment.folder
    with pytest.raises(InputError, match="another fish"):
        restore(after_a_swap(pool.flash), experiment)


def test_a_trial_that_waits_is_left_alone(
    swapped: Fish, experiment: Experiment, pool: Pool
) -> None:
    outcome = run_trial(swapped)
    swapped.sim.world.power_cycle()  # type: ignore[union-attr]
    swapped.link.run(1.0)
    found = restore(swapped, experiment)
    assert found.pending_trial == outcome.number == 5
    assert found.params == as_float32(PARAMS)  # it will be learned from with these
    assert swapped.status().pending_trial == 5
    with pytest.raises(InputError, match="trial 5 waits"):
        repeat_best(swapped, experiment, Somebody(), ONE)
    assert swapped.status().pending_trial == 5
    held = held_state(experiment)
    assert held is not None and held.learned == pool.learned


def test_another_reference_that_was_learned_is_not_lost(
    swapped: Fish, experiment: Experiment
) -> None:
    swapped.upload_reference(reference.trapezoid(0.05, 3, 2))
    run_trial(swapped)
    swapped.learn()
    mine = swapped.learned_record()
    with pytest.raises(InputError, match="another reference"):
        restore(swapped, experiment)
    assert swapped.learned_record() == mine


def test_a_reference_nothing_was_learned_along_gives_way(
    swapped: Fish, experiment: Experiment, pool: Pool
) -> None:
    swapped.upload_reference(reference.trapezoid(0.05, 3, 2))
    found = restore(swapped, experiment)
    assert found.reference and found.learned
    assert swapped.learned_record() == pool.learned


def test_what_was_set_on_purpose_since_stays(swapped: Fish, experiment: Experiment) -> None:
    """By a command: status's advice, trim, design. With the others, which are lost."""
    for name, value in (("AMP_MAX_RAD", 0.6), ("SERVO_CENTRE_US", 1533.0)):
        note_set(swapped, {name: swapped.params.set(name, value).value}, experiment)
    found = restore(swapped, experiment)
    assert set(found.params) == set(PARAMS) - {"AMP_MAX_RAD"}
    assert swapped.params.get("AMP_MAX_RAD").value == pytest.approx(0.6)
    assert swapped.params.get("SERVO_CENTRE_US").value == 1533.0
    swapped.params.set("SERVO_CENTRE_US", 1500.0)
    assert restore(swapped, experiment).params == {"SERVO_CENTRE_US": 1533.0}


def test_a_value_that_was_saved_long_ago_is_not_what_it_was(
    swapped: Fish, experiment: Experiment
) -> None:
    """Saved 4, set 3, not saved, switched off: what comes back is no default."""
    swapped.params.set("ILC_GAIN", 2.5)
    found = restore(swapped, experiment)
    held = held_state(experiment)
    assert held is not None and found.params["ILC_GAIN"] == held.params["ILC_GAIN"]
    assert found.params_before["ILC_GAIN"] == 2.5


def test_a_replaced_board_gets_every_parameter(experiment: Experiment) -> None:
    new = after_a_swap(SimBoard("tank", seed=77).flash, seed=77)
    new.params.set("ILC_LEAD", 2.0)
    assert restore(new, experiment, another_board=True).params["ILC_LEAD"] == 1.5


@pytest.mark.parametrize("another_board", [False, True])
def test_a_refusal_has_changed_nothing(
    another_board: bool, experiment: Experiment, pool: Pool
) -> None:
    seed = 77 if another_board else SEED
    fish = after_a_swap(SimBoard("tank", seed=seed).flash, seed=seed)
    fish.upload_reference(WANTED)
    fish.upload_learned(_record_with(pool.learned or b"", last_trial=2, iteration=9))
    before = fish.params.values()
    settings = experiment.settings()
    with pytest.raises(InputError, match=r"Nothing was changed\."):
        restore(fish, experiment, another_board)
    assert fish.params.values() == before
    assert experiment.settings() == settings


def test_a_trim_that_was_broken_off_is_put_back(
    swapped: Fish, experiment: Experiment, pool: Pool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And is nothing the experiment knows of; until then nothing else may swim."""

    class Killed(BaseException):
        """As by kill -9."""

    class Dying(Somebody):
        def tell(self, event: Event) -> None:
            if isinstance(event, BeatEvent) and event.beat == 2:
                raise Killed

    restore(swapped, experiment)
    before = swapped.params.values()
    with monkeypatch.context() as patch, pytest.raises(Killed):
        patch.setattr(preserve, "_put_back", lambda *_: None)
        find_centre(swapped, Dying())
    assert is_interrupted(swapped)
    swapped.link.run(10.0)
    assert swapped.status().pending_trial == 5 and swapped.status().state == "ABORTED"
    swapped.clear()
    use(swapped, experiment)
    _kept.discard_and_keep(swapped, None, False, "why not")  # is not refused, either
    assert is_interrupted(swapped)
    assert experiment.journal.decisions().get(5) is None
    found = restore(swapped, experiment)
    assert "was interrupted" in found.notes[0]
    assert found.pending_trial is None and not found.reference and not found.learned
    assert swapped.learned_record() == pool.learned
    assert swapped.params.values() == before
    assert not is_interrupted(swapped)
    assert repeat_best(swapped, experiment, Somebody(), ONE)[0].outcome.number == 6


def test_without_a_copy_it_gets_what_the_experiment_was_made_with(
    swapped: Fish, experiment: Experiment
) -> None:
    (experiment.folder / "board" / "state.json").unlink()
    made = experiment.settings()["params"]
    found = restore(swapped, experiment)
    assert found.params == {name: made[name] for name in found.params} and found.params
    assert not strayed(swapped, experiment)


def test_a_folder_made_by_hand_has_nothing_to_give(swapped: Fish, experiment: Experiment) -> None:
    (experiment.folder / "board" / "state.json").unlink()
    (experiment.raw / "reference.bin").unlink()
    with pytest.raises(InputError, match="no copy of a board, and no reference"):
        restore(swapped, experiment)


def test_a_stopped_board_says_why(swapped: Fish, experiment: Experiment) -> None:
    swapped.arm()
    with pytest.raises(InputError, match="ARMED, not IDLE"):
        restore(swapped, experiment)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_on_a_bad_radio(
    seed: int, experiment: Experiment, pool: Pool, spoil: Callable[..., BadRadio]
) -> None:
    fish = after_a_swap(SimBoard("tank", seed=SEED).flash)
    spoil(fish, seed, lose=0.15, damage=0.02, twice=0.05)
    assert restore(fish, experiment).learned
    assert fish.learned_record() == pool.learned


# The repeat


def test_the_repeat_is_a_repeat_and_nothing_is_learned(
    swapped: Fish, experiment: Experiment, pool: Pool
) -> None:
    restore(swapped, experiment)
    best = swapped.amplitudes(best=True).values
    somebody = Somebody()
    recorded, shift = repeat_best(swapped, experiment, somebody, ONE)
    trial = experiment.trials()[-1]
    assert trial.number == recorded.outcome.number == shift.repeat_trial == 5
    np.testing.assert_array_equal(trial.beats.applied_rad, best)
    assert experiment.journal.decisions()[5]["decision"] == "repeat"
    assert experiment.journal.decisions()[5]["reason"] == "battery swap"
    assert swapped.learned_record() == pool.learned
    assert swapped.status().pending_trial is None
    assert not (experiment.folder / "board" / "repeat.json").exists()
    held = held_state(experiment)
    assert held is not None and held.learned == pool.learned
    assert experiment.journal.entries("shifted")[-1]["within"] == shift.within
    assert somebody.count(LearnReport) == 0
    again = run_series(swapped, experiment, Somebody(), ONE)  # learning goes on where it was
    assert again.records[0].outcome.iteration == 5


def shift_after(pool: Pool, experiment: Experiment, gain: float) -> FishChange:
    fish = after_a_swap(pool.flash, gain=gain)
    restore(fish, experiment)
    return repeat_best(fish, experiment, Somebody(), ONE)[1]


def test_the_same_fish_is_within(pool: Pool, experiment: Experiment) -> None:
    shift = shift_after(pool, experiment, 1.0)
    assert shift.within and shift.remedy == "go on"
    assert shift.low_m_s <= shift.repeat_max_abs_error_m_s <= shift.high_m_s
    assert shift.thrust == pytest.approx(1.0, abs=0.06)
    assert "within noise" in shift.words and shift.words.endswith("tailbeat trial run")


def test_a_short_swim_tells_less_of_the_thrust(pool: Pool) -> None:
    """Four beats, a wider band: on 8 beats the same fish scatters by 5 % (tank plant)."""
    trials = Experiment(pool.experiment).trials()
    best = min(trials, key=lambda trial: trial.max_abs_error_m_s())
    model = prior_of({name: p.value for name, p in connect(SimBoard("tank")).params.list().items()})
    whole = change_of(trials, best, model.model)
    short = change_of(trials, replace(best, executed_beats=4), model.model)
    assert short.thrust_high - 1 > 1.2 * (whole.thrust_high - 1)


@pytest.mark.parametrize(("gain", "remedy"), [(0.93, "learn on"), (1.08, "learn on")])
def test_a_shifted_fish_is_seen(
    pool: Pool, experiment: Experiment, gain: float, remedy: str
) -> None:
    shift = shift_after(pool, experiment, gain)
    assert not shift.within and shift.remedy == remedy
    assert shift.thrust == pytest.approx(gain, abs=0.05)
    assert ("slower" if gain < 1 else "faster") in shift.words


def test_a_far_shift_is_identified_again(pool: Pool, experiment: Experiment) -> None:
    shift = shift_after(pool, experiment, 0.8)
    assert shift.remedy == "identify" and "tailbeat session identify" in shift.words
    assert shift.speed_shift_m_s < -5 * shift.speed_shift_sigma_m_s < 0


def test_a_fish_that_turns_is_trimmed_again(pool: Pool, experiment: Experiment) -> None:
    board = SimBoard("tank", seed=SEED)
    board.flash = pool.flash
    board.world.swap_battery(8.3, centre_rad=0.3)
    board.run(1.0)
    fish = connect(board)
    restore(fish, experiment)
    _, shift = repeat_best(fish, experiment, Somebody(), ONE)
    assert (
        shift.remedy == "trim"
        and "tailbeat session trim" in shift.words
        and "turned by" in shift.words
    )


@pytest.mark.soak
def test_how_often_it_is_right(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """20 fish along the thesis's reference, of seeds that nothing was tuned on."""
    monkeypatch.setenv("TAILBEAT_LOGBOOK", str(tmp_path / "logbook"))
    right = dict.fromkeys((1.0, 0.93), 0)
    for seed in range(101, 121):
        board = SimBoard("tank", seed=seed)
        fish = connect(board)
        for name, value in PARAMS.items():
            fish.params.set(name, value)
        fish.upload_reference(reference.thesis())
        experiment = begin(fish, tmp_path)
        run_series(fish, experiment, Somebody(), Options(Until(6), None))
        for gain in right:
            board.world.swap_battery(8.3, gain=gain)
            fish.link.run(2.0)
            restore(fish, experiment)
            shift = repeat_best(fish, experiment, Somebody(), ONE)[1]
            right[gain] += shift.within == (gain == 1.0)
    print(right)
    assert right[1.0] >= 18 and right[0.93] >= 16


def test_a_discarded_repeat_is_swum_again(swapped: Fish, experiment: Experiment) -> None:
    restore(swapped, experiment)
    somebody = Somebody(Decision("discard", "bumped the wall"))
    recorded, _ = repeat_best(swapped, experiment, somebody, ONE)
    decisions = experiment.journal.decisions()
    assert decisions[5]["decision"] == "discard" and decisions[6]["decision"] == "repeat"
    assert recorded.outcome.number == 6


def test_three_discards_end_it(swapped: Fish, experiment: Experiment, pool: Pool) -> None:
    restore(swapped, experiment)
    somebody = Somebody(*[Decision("discard", "it rolls")] * 3)
    with pytest.raises(TailbeatError, match="3 repeats came to nothing"):
        repeat_best(swapped, experiment, somebody, ONE)
    assert swapped.learned_record() == pool.learned


def test_nothing_learned_nothing_to_repeat(tmp_path: Path) -> None:
    fish = connect(SimBoard("tank", seed=5))
    fish.upload_reference(WANTED)
    experiment = begin(fish, tmp_path)
    copy_state(fish, experiment)
    assert restore(fish, experiment).iteration == 0
    with pytest.raises(TailbeatError, match="no trial that could be judged has been learned"):
        repeat_best(fish, experiment, Somebody(), ONE)


# Whatever goes wrong


def is_as_before(fish: Fish, experiment: Experiment, pool: Pool) -> None:
    """At once, or after the next call."""
    if fish.status().pending_trial is None:
        restore(fish, experiment)
    else:
        repeat_best(fish, experiment, Somebody(), ONE)
    assert fish.learned_record() == pool.learned
    assert fish.status().state == "IDLE" and fish.status().pending_trial is None
    truth = fish.sim.world.truth()  # type: ignore[union-attr]
    assert not truth.swimming and truth.pulse_ticks == 0


@contextmanager
def interrupted_at(fish: Fish, wait: int) -> Iterator[list[int]]:
    """Ctrl-C in the ``wait``-th time that anybody waits for the board."""
    real, count = fish.transport.wait, [0]

    def wait_then(timeout_s: float) -> None:
        count[0] += 1
        if count[0] == wait:
            raise KeyboardInterrupt
        real(timeout_s)

    fish.transport.wait = wait_then  # type: ignore[method-assign]
    try:
        yield count
    finally:
        fish.transport.wait = real  # type: ignore[method-assign]


@pytest.mark.parametrize("points", [8, pytest.param(60, marks=pytest.mark.soak)])
def test_ctrl_c_at_many_points(
    points: int, swapped: Fish, experiment: Experiment, pool: Pool
) -> None:
    restore(swapped, experiment)
    with interrupted_at(swapped, -1) as count:
        repeat_best(swapped, experiment, Somebody(), ONE)
    waits = np.r_[np.linspace(1, 60, points // 2), np.linspace(60, count[0], points // 2)]
    for point in np.unique(waits.astype(int)):
        with interrupted_at(swapped, int(point)), suppress(KeyboardInterrupt, TailbeatError):
            repeat_best(swapped, experiment, Somebody(), ONE)
        print(f"wait {point} of {count[0]}")
        is_as_before(swapped, experiment, pool)


def test_the_laptop_dies_between(swapped: Fish, experiment: Experiment, pool: Pool) -> None:
    """The best is on the board and nobody is there to put the other back."""
    restore(swapped, experiment)
    plan = Snapshot("", {}, next_trial=swapped.status().next_trial, learned=pool.learned or b"")
    write_held(experiment, plan)
    swapped.restore_best()
    copy_state(swapped, experiment)
    assert swapped.learned_record() != pool.learned
    restore(swapped, experiment)
    assert swapped.learned_record() == pool.learned
    assert not repeat_path(experiment).exists()


def test_the_laptop_dies_after_the_swim(swapped: Fish, experiment: Experiment, pool: Pool) -> None:
    """The repeat waits on the board: it is taken, not executed again, and not learned from."""
    restore(swapped, experiment)
    write_held(experiment, Snapshot("", {}, next_trial=5, learned=pool.learned or b""))
    swapped.restore_best()
    run_trial(swapped)
    restore(swapped, experiment)
    assert swapped.status().pending_trial == 5
    somebody = Somebody()
    recorded, shift = repeat_best(swapped, experiment, somebody, ONE)
    assert recorded.outcome.number == 5 and somebody.count(TrialStarted) == 0
    assert len(_decided(experiment, 5)) == 1
    assert shift.best_trial in (1, 2, 3, 4)
    assert swapped.learned_record() == pool.learned


def test_the_laptop_dies_after_the_decision(
    swapped: Fish, experiment: Experiment, pool: Pool
) -> None:
    """It is neither asked nor written down again."""
    restore(swapped, experiment)
    write_held(experiment, Snapshot("", {}, next_trial=5, learned=pool.learned or b""))
    swapped.restore_best()
    run_trial(swapped)
    log = keep_log(swapped, experiment, 5)
    account = SessionLog(experiment)
    recorded = record_of(outcome_of(log.trial), log, None)
    account.recorded(recorded)
    account.decided(recorded, Decision("repeat", "battery swap"))
    repeat_best(swapped, experiment, Somebody(Decision("discard", "asked again")), ONE)
    assert [entry["decision"] for entry in _decided(experiment, 5)] == ["repeat"]


def _decided(experiment: Experiment, trial: int) -> list[dict[str, Any]]:
    return [e for e in experiment.journal.entries("decided") if e["trial"] == trial]


def test_of_a_repeat_only_whether_it_counts_is_asked(
    swapped: Fish, experiment: Experiment, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Typed:
        """Presses c, once."""

        def __init__(self) -> None:
            self.left = ["c"]

        def pressed(self) -> bool:
            return False

        def forget(self) -> None: ...

        def key(self, timeout_s: float) -> str | None:
            return self.left.pop()  # a key that is no answer is asked for again

        def line(self) -> str:
            raise AssertionError

    asked: list[str] = []
    display = Display()
    monkeypatch.setattr(display, "ask", asked.append)
    restore(swapped, experiment)
    repeat_best(swapped, experiment, _operator(display, Typed(), False, repeats=True), ONE)
    assert asked == ["c = it counts, d = discard, Esc = later, Enter = it counts: "]
    assert experiment.journal.decisions()[5]["decision"] == "repeat"


def test_a_board_that_learned_since_is_left_alone(
    swapped: Fish, experiment: Experiment, pool: Pool
) -> None:
    write_held(experiment, Snapshot("", {}, next_trial=5, learned=pool.learned or b""))
    swapped.restore_best()
    run_trial(swapped)
    swapped.learn()
    mine = swapped.learned_record()
    restore(swapped, experiment)
    assert swapped.learned_record() == mine


def test_the_link_breaks_in_the_repeat(swapped: Fish, experiment: Experiment, pool: Pool) -> None:
    restore(swapped, experiment)
    board = swapped.sim
    assert board is not None
    radio = board.world.set_radio

    class Cutter(Somebody):
        def tell(self, event: Event) -> None:
            super().tell(event)
            if isinstance(event, BeatEvent) and event.beat == 3:
                radio(False)

    options = Options(until=Until(1), wanted=None, reconnect_s=20.0)
    with pytest.raises(TailbeatError, match="could not be put back") as error:
        repeat_best(swapped, experiment, Cutter(), options)
    assert "session resume" in str(error.value) and "\n" not in str(error.value)
    radio(True)
    swapped.link.run(10.0)
    assert swapped.status().state in ("ABORTED", "IDLE")
    swapped.clear()
    if swapped.status().pending_trial is not None:
        with pytest.raises(TailbeatError):  # cut short: it tells no shift
            repeat_best(swapped, experiment, Somebody(), ONE)
    is_as_before(swapped, experiment, pool)


def test_a_full_disk(
    swapped: Fish, experiment: Experiment, pool: Pool, monkeypatch: pytest.MonkeyPatch
) -> None:
    restore(swapped, experiment)

    def full(self: Experiment, path: Path) -> Path:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(Experiment, "keep_trial", full)
        with pytest.raises(InputError, match="No space left"):
            repeat_best(swapped, experiment, Somebody(), ONE)
    assert [file.number for file in swapped.trials()][-1] == 5  # its log is on the board
    is_as_before(swapped, experiment, pool)


def test_words_for_people(swapped: Fish, experiment: Experiment) -> None:
    found: Restored = restore(swapped, experiment)
    from tailbeat.app.cli.session import _restored_lines

    lines = _restored_lines(found, experiment).splitlines()
    assert lines[0].startswith("restored as") and "ILC_LEAD 1.5" in lines[0]
    assert "iteration 5 is next, 8.3" in lines[-1]
