"""Files over bad links: whole, bit-exact, resumed."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from tailbeat.board.fish import Fish
from tailbeat.core.errors import LinkLostError, TransferError
from tailbeat.core.records import crc32
from tailbeat.link.ftp.download import join
from tailbeat.link.ftp.wire import FtpError

PATH = "/in/speeds.bin"


def content(size: int, seed: int = 1) -> bytes:
    return random.Random(seed).randbytes(size)


@pytest.mark.parametrize("size", [0, 1, 238, 239, 240, 478, 5000, 16384])
def test_write_read_pull(fish: Fish, tmp_path: Path, size: int) -> None:
    data = content(size)
    fish.ftp.write(PATH, data)
    assert fish.ftp.crc32(PATH) == crc32(data)
    assert fish.ftp.read(PATH) == data
    assert fish.ftp.read(PATH, offset=size // 2) == data[size // 2 :]
    fish.ftp.pull(PATH, tmp_path / "file")
    assert (tmp_path / "file").read_bytes() == data
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_list_and_remove(fish: Fish) -> None:
    fish.ftp.write(PATH, b"12345")
    assert [(f.name, f.size, f.is_dir) for f in fish.ftp.list("/in")] == [("speeds.bin", 5, False)]
    assert "in" in [f.name for f in fish.ftp.list("/") if f.is_dir]
    fish.ftp.remove(PATH)
    assert fish.ftp.list("/in") == []
    with pytest.raises(FtpError) as missing:
        fish.ftp.remove(PATH)
    assert missing.value.code == 10


@pytest.mark.parametrize("path", ["/nothing", "/params.bin", "/learned.bin", "/../x", ""])
def test_what_is_not_in_the_tree(fish: Fish, tmp_path: Path, path: str) -> None:
    with pytest.raises(TransferError):
        fish.ftp.pull(path, tmp_path / "file")
    assert list(tmp_path.iterdir()) == []


def test_uploads_only_below_in(fish: Fish) -> None:
    with pytest.raises(FtpError):
        fish.ftp.write("/reference.bin", b"x")


@pytest.mark.parametrize("seed", range(6))
def test_bit_exact_over_a_bad_radio(fish: Fish, spoil, tmp_path: Path, seed: int) -> None:
    spoil(fish, seed, lose=0.1, damage=0.05, twice=0.1)
    data = content(9000, seed)
    fish.ftp.write(PATH, data)
    fish.ftp.pull(PATH, tmp_path / "file")
    assert (tmp_path / "file").read_bytes() == data


@pytest.mark.parametrize("stop", [KeyboardInterrupt, RuntimeError])
def test_an_interrupted_pull_goes_on_where_it_stopped(
    fish: Fish, tmp_path: Path, stop: type[BaseException]
) -> None:
    data = content(12000)
    fish.ftp.write(PATH, data)

    def interrupt(done: int, total: int) -> None:
        if done > 5000:
            raise stop

    with pytest.raises(stop):
        fish.ftp.pull(PATH, tmp_path / "file", interrupt)
    assert not (tmp_path / "file").exists()
    kept = (tmp_path / "file.part").stat().st_size
    assert 5000 < kept < 12000
    seen: list[int] = []
    fish.ftp.pull(PATH, tmp_path / "file", lambda done, _: seen.append(done))
    assert seen[0] > kept
    assert (tmp_path / "file").read_bytes() == data
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_a_beginning_of_another_file_is_not_used(fish: Fish, tmp_path: Path) -> None:
    fish.ftp.write(PATH, content(6000, 1))
    with pytest.raises(KeyboardInterrupt):
        fish.ftp.pull(PATH, tmp_path / "file", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    other = content(6000, 2)
    fish.ftp.write(PATH, other)
    seen: list[int] = []
    fish.ftp.pull(PATH, tmp_path / "file", lambda done, _: seen.append(done))
    assert seen[0] == 239
    assert (tmp_path / "file").read_bytes() == other


def test_a_damaged_beginning_is_thrown_away(fish: Fish, tmp_path: Path) -> None:
    data = content(6000)
    fish.ftp.write(PATH, data)

    def interrupt(done: int, total: int) -> None:
        if done > 3000:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fish.ftp.pull(PATH, tmp_path / "file", interrupt)
    part = tmp_path / "file.part"
    part.write_bytes(b"\xff" + part.read_bytes()[1:])
    fish.ftp.pull(PATH, tmp_path / "file")
    assert (tmp_path / "file").read_bytes() == data


def test_a_dead_link_ends_the_pull_and_keeps_the_beginning(fish: Fish, tmp_path: Path) -> None:
    assert fish.sim is not None
    board = fish.sim
    data = content(12000)
    fish.ftp.write(PATH, data)

    def cut(done: int, total: int) -> None:
        if done > 4000:
            board.world.set_radio(False)

    with pytest.raises(LinkLostError) as lost:
        fish.ftp.pull(PATH, tmp_path / "file", cut)
    assert "\n" not in str(lost.value)
    assert (tmp_path / "file.part").stat().st_size > 4000
    board.world.set_radio(True)
    fish.ftp.pull(PATH, tmp_path / "file")
    assert (tmp_path / "file").read_bytes() == data


def test_a_restart_of_the_board_in_the_middle(fish: Fish, tmp_path: Path) -> None:
    assert fish.sim is not None
    board = fish.sim
    data = content(12000)
    fish.ftp.write(PATH, data)
    todo = [board.world.power_cycle]

    def restart(done: int, total: int) -> None:
        if done > 4000 and todo:
            todo.pop()()

    fish.ftp.pull(PATH, tmp_path / "file", restart)
    assert (tmp_path / "file").read_bytes() == data


def test_pieces_that_overlap_or_come_twice_join_once() -> None:
    data = content(1000)
    ahead = {offset: data[offset : offset + 239] for offset in (0, 100, 200, 239, 700)}
    assert join(ahead, 0) == data[:478]
    assert list(ahead) == [700]
    assert join(ahead, 478) == b""
    assert join(ahead, 800) == data[800:939]


def test_progress_ends_at_the_size(fish: Fish) -> None:
    seen: list[tuple[int, int]] = []
    fish.ftp.write(PATH, content(1000), lambda *p: seen.append(p))
    assert seen[-1] == (1000, 1000)
    seen.clear()
    fish.ftp.read(PATH, progress=lambda *p: seen.append(p))
    assert seen[-1] == (1000, 1000)
