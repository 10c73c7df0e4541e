"""Keys on this computer, and which frames are believed; the other end is stock pymavlink."""

from __future__ import annotations

import json
import stat
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from tailbeat.app.cli import run
from tailbeat.board.fish import Fish
from tailbeat.board.provision import connect_notice, key_status, set_key
from tailbeat.core.errors import InputError
from tailbeat.core.files import WRITE_LOCK
from tailbeat.link import _dialect as mavlink
from tailbeat.link.keystore import (
    KeyStore,
    StoredKey,
    decode_key,
    encode_key,
    new_key,
    write_private,
)
from tailbeat.link.signing import Signing
from tailbeat.sim.board import CONSOLE, SimBoard, SimTransport

BOARD = "00112233445566778899aabbccddeeff"
KEY = StoredKey(bytes(range(1, 33)), BOARD, "fish", "2026-01-01T00:00:00+00:00", link_id=9)
OTHER = replace(KEY, key=bytes(range(2, 34)), created="2026-01-02T00:00:00+00:00")
T0 = 12 * 10**12


@pytest.fixture
def store(keys_folder: Path) -> KeyStore:
    return KeyStore()


# The store


def test_a_key_comes_back(store: KeyStore) -> None:
    assert not store
    store.save(KEY)
    assert store
    assert store.load() == ([KEY], [])
    assert store.find(None) == store.find("fish") == store.find(BOARD[:8]) == KEY
    assert store.find(KEY.fingerprint[:4]) == KEY


def test_new_keys_are_random_and_whole() -> None:
    keys = [new_key(BOARD) for _ in range(50)]
    assert len({key.key for key in keys}) == 50
    assert {len(key.key) for key in keys} == {32}
    assert all(1 <= key.link_id <= 255 for key in keys)


@pytest.mark.skipif(sys.platform == "win32", reason="no modes")
def test_nobody_else_can_read_it(store: KeyStore, keys_folder: Path) -> None:
    store.save(KEY)
    (path,) = keys_folder.glob("*.json")
    assert stat.S_IMODE(keys_folder.stat().st_mode) == 0o700
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    path.chmod(0o640)
    keys, problems = store.load()
    assert keys == []
    assert "others can read it" in problems[0]
    assert f"chmod 600 {path}" in problems[0]
    with pytest.raises(InputError, match="others can read it"):
        store.find(None)


def test_a_key_is_never_shown() -> None:
    for words in (repr(KEY), str(KEY.public()), KEY.fingerprint):
        assert KEY.key.hex()[:8] not in words
        assert "\\x01\\x02" not in words


@pytest.mark.parametrize(
    "content",
    [
        b"", b"null", b"[]", b'"tailbeat key 1"', b"{", b"\xff\xfe",
        encode_key(KEY).replace(b"key 1", b"key 2"),
        encode_key(KEY).replace(KEY.key.hex().encode(), b"00" * 32),
        encode_key(KEY).replace(KEY.key.hex().encode(), b"01" * 31),
        encode_key(KEY).replace(BOARD.encode(), b"../../etc/passwd"),
        encode_key(KEY).replace(b'"link_id": 9', b'"link_id": 0'),
        encode_key(KEY).replace(b'"heard": 0', b'"heard": 281474976710656'),
        encode_key(KEY).replace(b'"used": 0', b'"used": -1'),
        encode_key(KEY).replace(b'"link_id": 9', b'"link_id": 1e999'),
        encode_key(KEY).replace(b'"used": 0', b'"used": NaN'),
        encode_key(KEY).replace(b'"fish"', b'"fish\\u001b[2J"'),
        encode_key(KEY).replace(b'"fish"', b'"\\ud800"'),
        encode_key(KEY).replace(b'2026-01-01T', b'2026-01-01\\n'),
        b"[" * 30_000,
    ],
)  # fmt: skip
def test_damaged_files_are_told_and_left(
    store: KeyStore, keys_folder: Path, content: bytes
) -> None:
    store.save(OTHER)
    write_private(keys_folder / "bad.json", content)
    keys, problems = store.load()
    assert keys == [OTHER]
    assert len(problems) == 1
    assert "holds no key" in problems[0]
    assert KEY.key.hex() not in problems[0]


def test_time_never_goes_back_on_disk(store: KeyStore) -> None:
    store.save(replace(KEY, used=50, heard=70))
    store.save(replace(KEY, used=60, heard=10))
    store.note(KEY, 5, 80)
    assert store.usable() == [replace(KEY, used=60, heard=80)]


def test_a_forgotten_key_stays_forgotten(store: KeyStore) -> None:
    store.save(KEY)
    store.delete(KEY)
    store.note(KEY, 5, 5)
    assert store.usable() == []


def test_an_interrupted_write_leaves_the_old_file(
    store: KeyStore, keys_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store.save(KEY)

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    (old,) = keys_folder.glob("*.json")
    monkeypatch.setattr("tailbeat.core.files.os.fsync", full)
    with pytest.raises(InputError, match="No space left"):
        store.save(replace(KEY, used=5))
    monkeypatch.undo()
    assert {path.name for path in keys_folder.iterdir()} == {old.name, WRITE_LOCK}
    assert KeyStore(keys_folder).usable() == [KEY]


def test_which_key_is_meant(store: KeyStore) -> None:
    with pytest.raises(InputError, match="no key"):
        store.find(None)
    store.save(KEY)
    store.save(replace(OTHER, name="second"))
    with pytest.raises(InputError, match="several"):
        store.find(None)
    with pytest.raises(InputError, match="names no single key"):
        store.find(BOARD)
    assert store.find("second").key == OTHER.key
    store.delete_others(store.find("second"))
    assert [key.key for key in store.usable()] == [OTHER.key]


def test_a_second_computer_signs_under_a_number_of_its_own(store: KeyStore) -> None:
    for number in (1, 2, 254, 255):
        sent = replace(KEY, link_id=number, used=7, heard=9)
        got = store.add(decode_key(encode_key(sent), "file"))
        assert got.link_id != number
        assert (got.key, got.heard) == (KEY.key, 9)
        assert store.add(sent).link_id == got.link_id  # once more changes nothing
        store.delete(got)


def test_where_keys_lie(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert KeyStore().folder == Path(__import__("os").environ["TAILBEAT_KEYS"])
    monkeypatch.delenv("TAILBEAT_KEYS")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    assert KeyStore().folder == tmp_path / "tailbeat" / "keys"
    monkeypatch.delenv("XDG_CONFIG_HOME")
    assert KeyStore().folder == Path.home() / ".config" / "tailbeat" / "keys"


def test_a_name_that_cannot_be_shown_is_refused_before_it_is_kept() -> None:
    """A file with such a name would not be taken again."""
    with pytest.raises(InputError, match="name"):
        new_key(BOARD, "a\nb")


@pytest.mark.parametrize("words", [["list"], ["export"], ["status", "--connect", "sim"]])
def test_a_file_in_the_place_of_the_folder_is_told(
    words: list[str], keys_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    keys_folder.parent.mkdir(exist_ok=True)
    keys_folder.write_text("")
    assert run(["board", "key", *words]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert f"{keys_folder} is no folder" in err
    assert "TAILBEAT_KEYS" in err


def test_damaged_files_do_not_break_commands(
    keys_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = tmp_path / "bad.key"
    for content in (b"[" * 30_000, encode_key(KEY).replace(b'"link_id": 9', b'"link_id": 1e999')):
        bad.write_bytes(content)
        assert run(["board", "key", "import", str(bad)]) == 1
        assert "holds no key" in capsys.readouterr().err
        keys_folder.mkdir(parents=True, exist_ok=True)
        write_private(keys_folder / "bad.json", content)
        assert run(["board", "key", "list"]) == 0
        assert "holds no key" in capsys.readouterr().err


def test_where_an_export_cannot_go(
    store: KeyStore, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store.save(KEY)
    held = tmp_path / "fish.key"
    held.write_text("mine")
    assert run(["board", "key", "export", str(held)]) == 1
    assert capsys.readouterr().err == (
        f"tailbeat: {held} exists already. Delete it or take another name.\n"
    )
    assert held.read_text() == "mine"
    nowhere = tmp_path / "none" / "x"
    assert run(["board", "key", "export", str(nowhere)]) == 1
    assert capsys.readouterr().err.startswith(
        f"tailbeat: cannot write {nowhere} (No such file or directory). "
    )


def test_only_a_key_that_was_heard_counts_as_the_boards(store: KeyStore) -> None:
    heard = replace(KEY, heard=5)
    store.save(OTHER)  # newer, and never heard
    assert store.newest_of(BOARD) is None
    store.save(heard)
    assert store.newest_of(BOARD) == heard
    assert store.newest_of("0" * 32) is None
    store.save(replace(KEY, key=bytes(31) + b"x", heard=4))
    assert store.newest_of(BOARD) == heard


def test_a_key_that_went_missing_while_it_was_given_is_kept(store: KeyStore) -> None:
    store.save(OTHER)
    store.delete_others(KEY)
    assert store.usable() == [KEY]


# A key set that is broken off


class Interrupted(SimTransport):
    """Ctrl-C when a key is about to go out, or after it went."""

    def __init__(self, board: SimBoard, arrives: bool) -> None:
        super().__init__(board, CONSOLE)
        self.arrives = arrives

    def write(self, data: bytes) -> None:
        if data[7:10] == mavlink.MAVLINK_MSG_ID_SETUP_SIGNING.to_bytes(3, "little"):
            if self.arrives:
                super().write(data)
            raise KeyboardInterrupt
        super().write(data)


@pytest.mark.parametrize("had", [False, True])
@pytest.mark.parametrize("arrives", [False, True])
def test_ctrl_c_while_a_key_is_set(
    had: bool,
    arrives: bool,
    store: KeyStore,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    board = SimBoard("tank")
    if had:
        with Fish(SimTransport(board, CONSOLE)) as fish:
            fish.clock.sync()
            set_key(fish)
    before = store.usable()
    monkeypatch.setattr("tailbeat.board.fish.open_transport", lambda _: Interrupted(board, arrives))
    assert run(["board", "key", "set", "--connect", "wire"]) == 130
    assert capsys.readouterr().err == (
        "tailbeat: interrupted: the board may have the new key or not; look with: tailbeat board "
        "key"
        " status\n"
    )
    (new,) = (key for key in store.usable() if key not in before and not key.confirmed)
    assert run(["board", "key", "list"]) == 0
    assert capsys.readouterr().out.count("not heard from its board") == 1
    board.run(1.0)
    with Fish(SimTransport(board)) as fish:
        fish.clock.sync()
        status = key_status(fish)
        notice = connect_notice(fish)
    if arrives:
        assert status.held is not None
        assert status.held.key == new.key
        assert notice is None
        newest = store.newest_of(new.board)
        assert newest is not None
        assert newest.key == new.key
    else:
        assert (status.trust, status.lost) == ("held" if had else "open", None)
        assert "erased" not in (notice or "")
        assert len(store.usable()) == 1
        assert store.usable()[0].confirmed is had


# Which frames are believed


class Sender:
    """A board as stock pymavlink would be one."""

    def __init__(self, key: StoredKey | None = KEY, time: int = T0, link_id: int = 0) -> None:
        self.mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        self.mav.signing.timestamp = time
        self.mav.signing.link_id = link_id
        if key is not None:
            self.mav.signing.secret_key = key.key
            self.mav.signing.sign_outgoing = True

    def frame(self, number: int = 0) -> bytes:
        return bytes(mavlink.MAVLink_timesync_message(number, 1).pack(self.mav))


@pytest.fixture
def signing(store: KeyStore) -> Signing:
    store.save(OTHER)
    store.save(KEY)
    return Signing(store)


def test_the_key_that_fits_is_found(signing: Signing) -> None:
    assert (signing.key, signing.signs, signing.locked) == (None, None, False)
    assert signing.admit(Sender().frame(), 0.0)
    assert signing.key == KEY
    assert (signing.signs, signing.locked) == (True, False)


def test_a_board_with_another_key_is_read_unchecked(signing: Signing) -> None:
    stranger = Sender(replace(KEY, key=bytes(31) + b"x"))
    for _ in range(3):
        assert signing.admit(stranger.frame(), 0.0)
    assert signing.locked
    assert signing.key is None


def test_a_board_without_a_key(signing: Signing) -> None:
    assert signing.admit(Sender(None).frame(), 0.0)
    assert (signing.signs, signing.locked, signing.key) == (False, False, None)


def test_forged_replayed_and_unsigned_frames_are_dropped_and_counted(signing: Signing) -> None:
    board = Sender()
    first, second = board.frame(1), board.frame(2)
    assert signing.admit(second, 0.0)
    assert not signing.admit(second, 0.0)
    assert not signing.admit(first, 0.0)
    assert signing.refused.stale == 2
    assert "old" in signing.why_silent()
    for at in range(len(second)):
        forged = bytearray(Sender(time=T0 + 50).frame(3))
        forged[at] ^= 0x80
        if at != 2:  # the flags: then it is not signed
            assert not signing.admit(forged, 0.0), at
    assert signing.refused.wrong >= len(second) - 2
    assert not signing.admit(Sender(None).frame(), 0.0)
    assert signing.refused.unsigned == 1
    assert "not signed" in signing.why_silent()
    assert signing.admit(Sender(time=T0 + 5).frame(), 0.0)
    assert signing.why_silent() == ""


def test_a_forged_time_moves_nothing(signing: Signing) -> None:
    """With pymavlink's own check one such frame deafens the receiver."""
    board = Sender()
    assert signing.admit(board.frame(), 0.0)
    forged = bytearray(Sender(time=T0 + 10**12).frame())
    forged[-1] ^= 1
    assert not signing.admit(forged, 0.0)
    assert signing.admit(board.frame(), 0.0)


def test_what_an_earlier_run_heard_is_old(signing: Signing, store: KeyStore) -> None:
    board = Sender()
    frame = board.frame()
    assert signing.admit(frame, 0.0)
    signing.save()
    later = Signing(store)
    assert not later.admit(frame, 0.0)
    assert later.key is None
    assert later.admit(board.frame(), 0.0)


def receive(signing: Signing, now_s: float = 0.0, rate: float = 1.0) -> tuple[bytes, int]:
    """A frame of ours, as stock pymavlink takes it in, and its time."""
    frame = signing.pack(mavlink.MAVLink_timesync_message(0, 1), MAV, now_s, rate)
    taker = mavlink.MAVLink(None)
    taker.signing.secret_key = KEY.key
    assert taker.decode(bytearray(frame)).get_signed() is not None
    assert taker.signing.goodsig_count == 1
    return frame, taker.signing.timestamp


MAV = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)


def test_nothing_is_signed_before_the_board_was_heard(signing: Signing) -> None:
    assert not signing.pack(mavlink.MAVLink_timesync_message(0, 1), MAV, 0.0, 1.0)[2] & 1


def test_our_time_is_the_boards(signing: Signing) -> None:
    assert signing.admit(Sender().frame(), 100.0)
    frame, time = receive(signing, 100.0)
    assert frame[-13] == KEY.link_id
    assert T0 <= time <= T0 + 1
    assert receive(signing, 100.0)[1] == time + 1
    assert receive(signing, 101.0)[1] == T0 + 100_000
    assert receive(signing, 100.5)[1] == T0 + 100_001  # never back
    assert receive(signing, 100.2, 10.0)[1] == T0 + 200_000
    assert receive(signing, 1e6)[1] == T0 + 500_000  # a board that stands still is not pushed


def test_a_board_that_restarted_is_followed(signing: Signing) -> None:
    assert signing.admit(Sender().frame(), 0.0)
    receive(signing)
    mark = T0 + 60_000_000
    assert signing.admit(Sender(time=mark).frame(), 0.0)
    assert receive(signing)[1] >= mark


def test_the_computers_clock_does_not_matter(
    signing: Signing, monkeypatch: pytest.MonkeyPatch
) -> None:
    for now_s in (0.0, 4e9):
        monkeypatch.setattr("time.time", lambda now_s=now_s: now_s)
        board = Sender(time=T0 + round(now_s))
        assert signing.admit(board.frame(), 0.0)
        assert receive(signing)[1] <= T0 + now_s + 2


def test_a_new_run_goes_on_behind_the_last_one(signing: Signing, store: KeyStore) -> None:
    board = Sender()
    assert signing.admit(board.frame(), 0.0)
    last = [receive(signing, 2.0)[1] for _ in range(3)][-1]
    signing.save()
    later = Signing(store)
    assert later.admit(board.frame(), 0.0)
    assert receive(later)[1] > last


def test_time_is_kept_while_it_runs(signing: Signing, store: KeyStore) -> None:
    """A run that is killed loses a minute of it at most."""
    for second in range(200):
        assert signing.admit(Sender(time=T0 + second * 100_000).frame(), float(second))
    (kept,) = (key for key in store.usable() if key.key == KEY.key)
    assert T0 + 140 * 100_000 <= kept.heard <= T0 + 200 * 100_000


def test_keys_the_board_never_took_go_when_it_signs_with_another(
    signing: Signing, store: KeyStore
) -> None:
    elsewhere = replace(OTHER, key=bytes(31) + b"x", board="f" * 32)
    heard = replace(OTHER, key=bytes(31) + b"y", heard=7)
    store.save(elsewhere)
    store.save(heard)
    assert signing.admit(Sender().frame(), 0.0)
    assert {key.key for key in store.usable()} == {KEY.key, elsewhere.key, heard.key}


def test_a_key_on_its_way_to_the_board_is_kept(signing: Signing, store: KeyStore) -> None:
    signing.offer(OTHER)
    assert signing.admit(Sender().frame(), 0.0)
    assert {key.key for key in store.usable()} == {KEY.key, OTHER.key}


def test_a_key_is_confirmed_by_the_first_frame(store: KeyStore) -> None:
    store.save(KEY)
    assert Signing(store).admit(Sender(time=5).frame(), 0.0)  # a clock that has just begun
    assert [key.confirmed for key in store.usable()] == [True]


def test_a_key_from_the_far_future_has_a_way_out(store: KeyStore) -> None:
    store.save(replace(KEY, heard=(1 << 48) - 2))
    signing = Signing(store)
    assert not signing.admit(Sender().frame(), 0.0)
    assert "tailbeat board key delete" in signing.why_silent()


def test_a_key_on_offer_is_taken_when_it_shows(signing: Signing) -> None:
    new = replace(new_key(BOARD), heard=0)
    assert signing.admit(Sender().frame(), 0.0)
    assert not signing.admit(Sender(new).frame(), 0.0)
    signing.offer(new)
    assert signing.admit(Sender(time=T0 + 2).frame(), 0.0)  # the old one still
    assert signing.key == KEY
    assert signing.admit(Sender(new, time=T0 + 5).frame(), 0.0)
    assert signing.key == new
    assert not signing.admit(Sender(time=T0 + 9).frame(), 0.0)


def test_files_hold_what_they_say(store: KeyStore, keys_folder: Path) -> None:
    store.save(KEY)
    (path,) = keys_folder.glob("*.json")
    document = json.loads(path.read_text())
    assert (document["format"], document["key"]) == ("tailbeat key 1", KEY.key.hex())
    assert document["board"] == BOARD
