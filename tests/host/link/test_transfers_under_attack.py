"""Files, parameters, commands and learning over lines that lose, damage, delay and break."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from tailbeat.board.fish import Fish
from tailbeat.core import records
from tailbeat.core.errors import LinkLostError, TransferError
from tailbeat.core.records import crc32
from tailbeat.core.speed_estimate import recompute_beats
from tailbeat.core.trial_file import read_trial
from tailbeat.link import _dialect as mavlink
from tailbeat.link.impaired import (
    Corrupt,
    Cut,
    Delay,
    Drop,
    Duplicate,
    Fault,
    HalfOpen,
    ImpairedLine,
    Standstill,
    Truncate,
    hc05,
)
from tailbeat.link.mavlink import TRIES
from tailbeat.session.next_input import dry_run
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import SimBoard, SimTransport

PATH = "/in/speeds.bin"
BEATS, TRIALS = 6, 6
UPLOAD, VISION = 1, 0
LONGEST = 16384
SPEEDS = 0.07 * np.sin(np.linspace(0.2, 2.9, BEATS))
Faults = Callable[[], list[Fault]]

LOST: Faults = lambda: [Drop(0.2)]  # noqa: E731
WRONG: Faults = lambda: [Corrupt(1e-3)]  # noqa: E731
ALL: Faults = lambda: [  # noqa: E731
    Drop(0.1), Corrupt(3e-4), Duplicate(0.1), Truncate(0.03), Standstill(7.0, 0.8, True), hc05()
]  # fmt: skip


def content(size: int, seed: int = 1) -> bytes:
    return np.random.default_rng(seed).bytes(size)


def over(faults: Faults, seed: int = 1, board: SimBoard | None = None) -> Fish:
    board = board or SimBoard("tank", seed=7)
    return Fish(ImpairedLine(SimTransport(board), faults(), faults(), seed))


def board_of(fish: Fish) -> SimBoard:
    assert isinstance(fish.sim, SimBoard)
    return fish.sim


# -- a whole session -------------------------------------------------------------------------------


@dataclass
class Session:
    amplitudes: list[bytes] = field(default_factory=list)
    logs: list[bytes] = field(default_factory=list)
    asked: int = 0
    took_s: float = 0.0


def learn_six(fish: Fish, source: int, folder: Path) -> Session:
    """Six trials, learned from; what the board holds is checked after each."""
    told = Session()
    ask = fish.link.attempts

    def counted(*args: float, **more: float) -> Iterator[float]:
        told.asked += 1
        return ask(*args, **more)

    fish.link.attempts = counted  # type: ignore[method-assign,assignment]
    for name, value in {"SPD_SOURCE": source, "ILC_LEAD": 1, "DU_MAX_RAD": 0}.items():
        fish.params.set(name, value)
    fish.params.save()
    fish.params.load()
    fish.upload_reference(records.encode_reference(1.0, SPEEDS))
    for number in range(1, TRIALS + 1):
        outcome = run_trial(fish)
        assert (outcome.number, outcome.end) == (number, "complete")
        if source == UPLOAD:
            fish.upload_speeds(
                number, board_of(fish).world.true_beats()[:BEATS], np.full(BEATS, 1e-3)
            )
        computed = dry_run(fish)
        path = fish.pull_trial(number, folder)
        trial = read_trial(path)
        assert not trial.problems
        if source == VISION:
            assert np.array_equal(recompute_beats(trial)[0], trial.beats.speed_m_s, equal_nan=True)
        assert fish.learn(number).measured_beats >= BEATS - 1
        told.amplitudes.append(fish.amplitudes().values.tobytes())
        assert told.amplitudes[-1] == computed.amplitude_rad.tobytes()
        told.logs.append(path.read_bytes())
    told.took_s = fish.transport.now_s()
    return told


def files_on(fish: Fish) -> list[bytes]:
    """The trial logs as a line without faults brings them."""
    with Fish(SimTransport(board_of(fish))) as clean:
        return [clean.ftp.read(trial.path) for trial in clean.trials()]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Session:
    with over(list) as fish:
        return learn_six(fish, UPLOAD, tmp_path_factory.mktemp("clean"))


@pytest.mark.parametrize("faults", [LOST, WRONG], ids=["20 % lost", "1e-3 wrong"])
def test_uploaded_speeds_teach_what_they_teach_without_faults(
    undisturbed: Session, faults: Faults, tmp_path: Path
) -> None:
    with over(faults) as fish:
        told = learn_six(fish, UPLOAD, tmp_path)
        assert told.amplitudes == undisturbed.amplitudes
        assert told.logs == files_on(fish)


@pytest.mark.parametrize("faults", [LOST, ALL], ids=["20 % lost", "all at once"])
def test_seen_speeds_teach_what_the_host_computes(faults: Faults, tmp_path: Path) -> None:
    with over(faults, seed=2) as fish:
        told = learn_six(fish, VISION, tmp_path)
        assert len(set(told.amplitudes)) == TRIALS
        assert told.logs == files_on(fish)


@pytest.mark.soak
def test_many_sessions(undisturbed: Session, tmp_path: Path) -> None:
    for name, faults in {"20 % lost": LOST, "1e-3 wrong": WRONG, "all at once": ALL}.items():
        took = []
        for seed in range(1, 41):
            with over(faults, seed) as fish:
                told = learn_six(fish, seed % 2, tmp_path / f"{name}{seed}")
                assert seed % 2 == VISION or told.amplitudes == undisturbed.amplitudes
                took.append(told.took_s)
        print(f"{name}: 40 sessions of six trials, {np.mean(took):.0f} s each ({max(took):.0f})")


def test_the_tries_suffice(undisturbed: Session) -> None:
    """A session fails when one of its requests is lost as often as it is said."""
    lost = 1 - 0.8 * 0.8
    fails = undisturbed.asked * lost**TRIES
    print(f"{undisturbed.asked} requests a session, {TRIES} tries each: fails with {fails:.1e}")
    assert fails < 1e-4


# -- files -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("faults", [LOST, WRONG, ALL], ids=["20 % lost", "1e-3 wrong", "all"])
@pytest.mark.parametrize("size", [0, 1, 239, LONGEST])
def test_files_are_bit_exact(faults: Faults, size: int, tmp_path: Path) -> None:
    data = content(size)
    with over(faults, seed=size + 1) as fish:
        fish.ftp.write(PATH, data)
        fish.ftp.pull(PATH, tmp_path / "file")
        assert (tmp_path / "file").read_bytes() == data
        assert [p.name for p in tmp_path.iterdir()] == ["file"]


@pytest.fixture(scope="module")
def long_flash() -> bytes:
    with Fish.connect("sim:tank", seed=1) as fish:
        fish.params.set("TANK_LEN_M", 0)
        fish.upload_reference(records.encode_reference(1.0, [0.03] * 150))
        run_trial(fish)
        return board_of(fish).flash


@pytest.mark.parametrize("faults", [LOST, WRONG], ids=["20 % lost", "1e-3 wrong"])
def test_a_long_trial_comes_whole(long_flash: bytes, faults: Faults, tmp_path: Path) -> None:
    board = SimBoard("tank")
    board.flash = long_flash
    board.world.power_cycle()
    with over(faults, 5, board) as fish:
        path = fish.pull_trial(1, tmp_path)
        assert not read_trial(path).problems
        assert path.stat().st_size > 3 * LONGEST
        assert [path.read_bytes()] == files_on(fish)


def share_used(flash: bytes, lost: float, seed: int, folder: Path) -> float:
    """Of the line, by the bytes of a long trial's log."""
    board = SimBoard("tank")
    board.flash = flash
    board.world.power_cycle()
    with over(lambda: [Drop(lost)], seed, board) as fish:
        fish.link.run(2.0)
        begin_s = fish.transport.now_s()
        pulled = folder / f"{lost}{seed}"
        fish.ftp.pull("/trials/0001.ulg", pulled)
        size = pulled.stat().st_size
        return size / (fish.transport.now_s() - begin_s) / board.config["link_bytes_per_s"]


@pytest.mark.parametrize(("lost", "share", "seeds"), [(0.0, 0.885, 1), (0.05, 0.8, 6)])
def test_the_line_stays_full(
    long_flash: bytes, lost: float, share: float, seeds: int, tmp_path: Path
) -> None:
    """Means; the file of bench/link_throughput.py is longer."""
    used = [share_used(long_flash, lost, seed, tmp_path) for seed in range(1, seeds + 1)]
    print(f"{lost:.0%} lost: {np.round(used, 3)} of the line")
    assert share < np.mean(used) < 0.9


def test_parameters_over_a_bad_line() -> None:
    with over(ALL, seed=4) as fish:
        held = fish.params.values()
        fish.params.set("ILC_GAIN", 7.5)
        fish.params.save()
        fish.params.set("ILC_GAIN", 1.5)
        fish.params.load()
        assert fish.params.values() == held | {"ILC_GAIN": 7.5}


def test_a_late_answer_to_an_earlier_change_is_not_a_refusal() -> None:
    with over(lambda: [Delay(0.5, 0.7)]) as fish:
        for value in (2.0, 3.0, 4.0, 5.0):
            assert fish.params.set("ILC_GAIN", value).value == value
        assert fish.params.get("ILC_GAIN").value == 5.0


# -- the board restarts, somebody presses Ctrl-C ---------------------------------------------------


class Nth(SimTransport):
    """Does something in the n-th wait."""

    def __init__(self, board: SimBoard, n: int, what: Callable[[], None]) -> None:
        super().__init__(board)
        self.waits, self._n, self._what = 0, n, what

    def wait(self, timeout_s: float) -> None:
        self.waits += 1
        if self.waits == self._n:
            self._what()
        super().wait(timeout_s)


def at_every(step: int, what: Callable[[SimBoard], None], do: Callable[[Fish], object]) -> int:
    """``do`` with ``what`` at its n-th wait, for every ``step``-th n until it has fewer waits."""
    n = 1
    while True:
        board = SimBoard("tank")
        with Fish(SimTransport(board)) as fish:
            fish.ftp.write(PATH, content(3000))
        transport = Nth(board, n, lambda board=board: what(board))
        with Fish(transport) as fish:
            do(fish)
        if transport.waits < n:
            return n
        n += step


def test_a_pull_survives_a_restart_at_any_moment(tmp_path: Path) -> None:
    def do(fish: Fish) -> None:
        fish.ftp.pull(PATH, tmp_path / "file")
        assert (tmp_path / "file").read_bytes() == content(3000)
        (tmp_path / "file").unlink()

    assert at_every(1, lambda board: board.world.power_cycle(), do) > 10


def test_an_upload_survives_a_restart_at_any_moment() -> None:
    def do(fish: Fish) -> None:
        fish.ftp.write(PATH, content(2500, 2))
        assert fish.ftp.crc32(PATH) == crc32(content(2500, 2))

    assert at_every(1, lambda board: board.world.power_cycle(), do) > 10


def interrupt(_: SimBoard) -> None:
    raise KeyboardInterrupt


def test_ctrl_c_at_any_moment_leaves_a_good_beginning(tmp_path: Path) -> None:
    whole = content(3000)
    kept: list[int] = []

    def do(fish: Fish) -> None:
        local = tmp_path / "file"
        try:
            fish.ftp.pull(PATH, local)
        except KeyboardInterrupt:
            assert not local.exists()
            part = tmp_path / "file.part"
            held = part.read_bytes() if part.exists() else b""
            assert whole.startswith(held)
            seen: list[int] = []
            fish.ftp.pull(PATH, local, lambda done, _: seen.append(done))
            assert min(seen) > len(held) or len(held) == len(whole)
            kept.append(len(held))
        assert local.read_bytes() == whole
        assert [p.name for p in tmp_path.iterdir()] == ["file"]
        local.unlink()

    at_every(1, interrupt, do)
    assert len(set(kept)) > 5


def test_ctrl_c_in_an_upload_leaves_nothing_half() -> None:
    def do(fish: Fish) -> None:
        reference = records.encode_reference(1.0, [0.02] * 100)
        try:
            fish.upload_reference(reference)
        except KeyboardInterrupt:
            assert fish.reference_record() in (None, reference)
            fish.upload_reference(reference)
        with Fish(SimTransport(board_of(fish))) as clean:
            assert clean.reference_record() == reference

    assert at_every(1, interrupt, do) > 5


def begun(fish: Fish, local: Path, most: int = 4000) -> None:
    """Pulls a part."""

    def stop(done: int, total: int) -> None:
        if done > most:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fish.ftp.pull(PATH, local, stop)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda part, note: part.write_bytes(part.read_bytes().swapcase()),
        lambda part, note: part.write_bytes(part.read_bytes()[:100]),
        lambda part, note: note.write_text("{}"),
        lambda part, note: note.write_text(note.read_text().replace(PATH, "/trials/0001.ulg")),
        lambda part, note: note.unlink(),
        lambda part, note: part.unlink(),
    ],
)
def test_a_beginning_that_is_not_ours_is_noticed_at_once(
    fish: Fish, tmp_path: Path, spoil: Callable[[Path, Path], object]
) -> None:
    fish.ftp.write(PATH, content(9000))
    begun(fish, tmp_path / "file")
    spoil(tmp_path / "file.part", tmp_path / "file.part.json")
    seen: list[int] = []
    fish.ftp.pull(PATH, tmp_path / "file", lambda done, _: seen.append(done))
    assert seen[0] == 239
    assert seen == sorted(seen)  # once, not a second time after the whole was found damaged
    assert (tmp_path / "file").read_bytes() == content(9000)


def test_bytes_behind_the_note_are_not_trusted(fish: Fish, tmp_path: Path) -> None:
    fish.ftp.write(PATH, content(9000))
    begun(fish, tmp_path / "file")
    part = tmp_path / "file.part"
    held = part.stat().st_size
    part.write_bytes(part.read_bytes() + b"torn")
    seen: list[int] = []
    fish.ftp.pull(PATH, tmp_path / "file", lambda done, _: seen.append(done))
    assert seen[0] > held
    assert (tmp_path / "file").read_bytes() == content(9000)


def test_a_file_that_changed_meanwhile_starts_anew(fish: Fish, tmp_path: Path) -> None:
    fish.ftp.write(PATH, content(9000))
    begun(fish, tmp_path / "file")
    fish.ftp.write(PATH, content(9000, 2))
    fish.ftp.pull(PATH, tmp_path / "file")
    assert (tmp_path / "file").read_bytes() == content(9000, 2)


# -- the end of patience ---------------------------------------------------------------------------


class _Later(SimTransport):
    """Its clock begins at 0 when the line is put in."""

    def __init__(self, board: SimBoard) -> None:
        super().__init__(board)
        self._begin_s = board.time_s

    def now_s(self) -> float:
        return super().now_s() - self._begin_s


@dataclass
class Lasting:
    """After so many bytes, loses all frames of a kind."""

    after: int
    where: Callable[[bytes], bool]

    def take(self, piece, dice):  # type: ignore[no-untyped-def]
        self.after -= len(piece.data)
        return () if self.after < 0 and self.where(piece.data) else (piece,)


def is_file_data(frame: bytes) -> bool:
    return len(frame) > 10 and frame[7] == mavlink.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL


@pytest.mark.parametrize(
    ("up", "down", "words"),
    [
        ([], [HalfOpen(0.5)], "nothing for 1"),
        ([HalfOpen(0.5)], [Drop(0.3, lambda frame: len(frame) > 200)], "nothing for 2"),
        ([], [Lasting(9000, is_file_data)], "nothing for 2"),
        ([Cut(at_s=0.5)], [], "broke"),
    ],
    ids=["deaf", "dumb", "no data", "cut"],
)
def test_a_pull_that_stands_still_ends_in_one_line(
    up: list[Fault], down: list[Fault], words: str, tmp_path: Path
) -> None:
    board = SimBoard("tank")
    with Fish(SimTransport(board)) as clean:
        clean.ftp.write(PATH, content(LONGEST))
        begin_s = clean.transport.now_s()
    with Fish(ImpairedLine(_Later(board), up, down)) as fish:
        with pytest.raises(LinkLostError, match=words) as lost:
            fish.ftp.pull(PATH, tmp_path / "file")
        print(lost.value)
        assert "\n" not in str(lost.value)
        assert lost.value.remedy
    assert board.time_s - begin_s < 40.0
    assert not (tmp_path / "file").exists()
    held = (tmp_path / "file.part").stat().st_size
    assert held < LONGEST
    with Fish(SimTransport(board)) as clean:
        seen: list[int] = []
        clean.ftp.pull(PATH, tmp_path / "file", lambda done, _: seen.append(done))
        assert seen[0] > held
    assert (tmp_path / "file").read_bytes() == content(LONGEST)


def test_an_upload_that_stands_still_ends_in_one_line() -> None:
    board = SimBoard("tank")
    board.run(4.0)
    with Fish(ImpairedLine(_Later(board), [HalfOpen(0.5)])) as fish:
        with pytest.raises(LinkLostError, match="went up") as lost:
            fish.ftp.write(PATH, content(LONGEST))
        print(lost.value)
        assert fish.transport.now_s() < 40.0


def test_a_board_that_is_heard_but_does_not_hear_is_told_apart() -> None:
    with over(lambda: []) as fish:
        fish.status()
        fish.link.transport = ImpairedLine(fish.transport, up=[HalfOpen(0.0)])
        with pytest.raises(LinkLostError, match="heard but does not answer"):
            fish.link.request("AUTOPILOT_VERSION")


def test_a_damaged_file_never_gets_its_name(
    fish: Fish, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fish.ftp.write(PATH, content(1000))
    monkeypatch.setattr("tailbeat.link.ftp.client.crc32", lambda data: 1)
    with pytest.raises(TransferError, match="damaged"):
        fish.ftp.pull(PATH, tmp_path / "file")
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(TransferError, match="damaged"):
        fish.ftp.write(PATH, b"x")
