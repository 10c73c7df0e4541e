"""Keys from the user's side: set, carried, lost; and what a stranger gets from a board with one."""

from __future__ import annotations

import json
import stat
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tailbeat.app.cli import run
from tailbeat.board.fish import Fish
from tailbeat.board.provision import (
    _SHORT_LIVED,
    connect_notice,
    give_back,
    key_status,
    set_key,
    signing_time,
)
from tailbeat.core import records
from tailbeat.core.errors import LinkLostError, Refused
from tailbeat.link import _dialect as mavlink
from tailbeat.link.frames import Framer
from tailbeat.link.keystore import KeyStore, StoredKey
from tailbeat.link.messages import BeatEvent
from tailbeat.session.trial import run_trial
from tailbeat.sim import emulated
from tailbeat.sim.board import CONSOLE, FLASH_BYTES, RADIO, SimBoard, SimTransport


class Tap:
    """Between a connected fish and its board: shows what goes out, changes what comes in."""

    def __init__(self, fish: Fish) -> None:
        self.inner = fish.link.transport
        self.sent: list[bytes] = []
        self.on_write: Callable[[bytes], bool] | None = None
        self.on_read: Callable[[bytes], bytes] | None = None
        fish.link.transport = self

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)

    def write(self, data: bytes) -> None:
        self.sent.append(data)
        if self.on_write is None or self.on_write(data):
            self.inner.write(data)

    def read(self) -> bytes:
        data = self.inner.read()
        return data if self.on_read is None else self.on_read(data)


REFUSED = "tailbeat: this board accepts only signed messages. Bring the key"


class Laptop:
    """A computer with keys of its own, next to a board."""

    def __init__(
        self, board: SimBoard, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
    ) -> None:
        self.board, self.folder, self.monkeypatch, self.capsys = board, folder, monkeypatch, capsys

    def here(self) -> None:
        """From now on commands are typed on this one."""
        self.monkeypatch.setenv("TAILBEAT_KEYS", str(self.folder))

    def open_transport(self, url: str | None) -> SimTransport:
        return SimTransport(self.board, CONSOLE if url == "wire" else RADIO)

    def call(self, *words: str) -> tuple[int, str, str]:
        self.here()
        self.monkeypatch.setattr("tailbeat.board.fish.open_transport", self.open_transport)
        return (run([*words]), *self.capsys.readouterr())

    def text(self, *words: str, err: str = "") -> str:
        status, out, said = self.call(*words)
        assert (status, said) == (0, err), said
        return str(out)

    def json(self, *words: str) -> Any:
        return json.loads(self.text(*words, "--json"))

    def fails(self, *words: str) -> str:
        status, out, err = self.call(*words)
        assert (status, out) == (1, "")
        return str(err)

    def fish(self, port: int = RADIO) -> Fish:
        self.here()
        self.board.read(port)
        fish = Fish(SimTransport(self.board, port))
        fish.clock.sync()
        return fish

    def key(self) -> StoredKey:
        (key,) = KeyStore(self.folder).usable()
        return key


@pytest.fixture
def board() -> SimBoard:
    return SimBoard("tank")


@pytest.fixture
def laptop(
    board: SimBoard, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> Callable[[str], Laptop]:
    return lambda name: Laptop(board, tmp_path / name, monkeypatch, capsys)


@pytest.fixture
def owner(laptop: Callable[[str], Laptop]) -> Laptop:
    """Has just given the board its key."""
    owner = laptop("owner")
    owner.text("board", "key", "set", "--name", "fish", "--connect", "wire")
    return owner


def upload_reference(fish: Fish) -> bytes:
    record = records.encode_reference(1.0, 0.06 * np.sin(np.linspace(0.2, 2.9, 6)))
    fish.upload_reference(record)
    return record


# Setting, replacing, erasing


def test_from_no_key_to_one_and_back(laptop: Callable[[str], Laptop]) -> None:
    owner = laptop("owner")
    before = owner.json("board", "key", "status", "--connect", "radio")
    assert (before["trust"], before["held"], before["lost"]) == ("open", None, None)
    line = owner.text("board", "key", "set", "--connect", "wire")
    assert owner.key().fingerprint in line
    assert "key export" in line
    for port in ("radio", "wire"):
        held = owner.json("board", "key", "status", "--connect", port)
        assert (held["trust"], held["held"]["key"]) == ("held", owner.key().fingerprint)
    assert owner.text("params", "set", "ILC_LEAD", "2", "--connect", "radio")
    assert owner.text("board", "key", "status", "--connect", "radio").count("\n") == 3
    gone = owner.json("board", "key", "erase", "--connect", "wire")
    assert gone["erased"]["key"] == held["held"]["key"]
    assert owner.json("board", "key", "list")["keys"] == []
    assert owner.json("board", "key", "status", "--connect", "radio")["trust"] == "open"
    assert owner.json("board", "key", "erase", "--connect", "wire") == {"erased": None}


def test_no_key_is_ever_shown(owner: Laptop) -> None:
    secret = owner.key().key.hex()
    for words in (["list"], ["status", "--connect", "radio"], ["set", "--connect", "wire"]):
        for extra in ([], ["--json"]):
            _, out, err = owner.call("board", "key", *words, *extra)
            assert secret[:12] not in out + err
    assert owner.key().key.hex() not in owner.text("board", "key", "list")


def test_not_over_the_radio(laptop: Callable[[str], Laptop]) -> None:
    owner = laptop("owner")
    line = owner.fails("board", "key", "set", "--connect", "radio")
    assert line.startswith("tailbeat: the key can only be set over USB serial. Connect")
    assert owner.json("board", "key", "list")["keys"] == []
    owner.text("board", "key", "set", "--connect", "wire")
    key = owner.key()
    assert "USB serial" in owner.fails("board", "key", "set", "--connect", "radio")
    assert "USB serial" in owner.fails("board", "key", "erase", "--connect", "radio")
    assert owner.key().key == key.key
    assert owner.json("board", "key", "status", "--connect", "radio")["trust"] == "held"


def test_not_while_armed(owner: Laptop) -> None:
    with owner.fish() as fish:
        upload_reference(fish)
        fish.arm()
    key = owner.key()
    assert "not possible in this state" in owner.fails("board", "key", "set", "--connect", "wire")
    assert "not possible in this state" in owner.fails("board", "key", "erase", "--connect", "wire")
    assert owner.key().key == key.key
    assert owner.json("board", "disarm", "--connect", "radio")["state"] == "IDLE"


def test_a_second_set_replaces(owner: Laptop) -> None:
    first = owner.key()
    owner.text("board", "key", "set", "--connect", "wire")
    second = owner.key()
    assert second.key != first.key
    assert (
        owner.json("board", "key", "status", "--connect", "radio")["held"]["key"]
        == second.fingerprint
    )
    KeyStore(owner.folder).delete(second)
    KeyStore(owner.folder).save(first)
    assert REFUSED in owner.fails("params", "set", "ILC_LEAD", "1", "--connect", "radio")


def lose(fish: Fish, answers: int, requests: int) -> None:
    """Loses so many of what comes after the key was sent, then so many of what goes out."""
    radio = Tap(fish)
    left = {"answers": answers, "requests": requests}
    armed: list[bool] = []

    def on_write(data: bytes) -> bool:
        if int.from_bytes(data[7:10], "little") != mavlink.MAVLINK_MSG_ID_SETUP_SIGNING:
            return True
        armed.append(True)
        left["requests"] -= 1
        return left["requests"] < 0

    def read(data: bytes) -> bytes:
        if armed and data and left["answers"] > 0:
            left["answers"] -= 1
            return b""
        return data

    radio.on_write, radio.on_read = on_write, read


@pytest.mark.parametrize(("answers", "requests"), [(1, 0), (5, 0), (0, 2), (3, 2)])
@pytest.mark.parametrize("first", [True, False])
def test_lost_words_do_not_lock_out(
    laptop: Callable[[str], Laptop], answers: int, requests: int, first: bool
) -> None:
    owner = laptop("owner")
    with owner.fish(CONSOLE) as fish:
        if not first:
            set_key(fish)
        lose(fish, answers, requests)
        key = set_key(fish)
        fish.params.set("ILC_LEAD", 3)
    assert owner.key().key == key.key
    with owner.fish() as fish:
        assert fish.params.get("ILC_LEAD").value == 3.0


@pytest.mark.parametrize("reached", [True, False])
def test_a_set_that_is_interrupted(laptop: Callable[[str], Laptop], reached: bool) -> None:
    """Whether the board got the new key or not: this computer has the one it signs with."""
    owner = laptop("owner")
    with owner.fish(CONSOLE) as fish:
        set_key(fish)
    with owner.fish(CONSOLE) as fish:
        radio = Tap(fish)

        def interrupt(data: bytes) -> bool:
            if data[7] == 0 and data[8] == 1:  # SETUP_SIGNING
                if reached:
                    radio.inner.write(data)
                raise KeyboardInterrupt
            return True

        radio.on_write = interrupt
        with pytest.raises(KeyboardInterrupt):
            set_key(fish)
        radio.on_write = None
    assert len(KeyStore(owner.folder).usable()) == 2
    owner.board.run(0.2)  # what was on the line is signed with the old key
    with owner.fish(CONSOLE) as fish:
        fish.params.set("ILC_LEAD", 3)
        set_key(fish)
    assert len(KeyStore(owner.folder).usable()) == 1


def test_no_answer_at_all_keeps_the_key(laptop: Callable[[str], Laptop]) -> None:
    owner = laptop("owner")
    with owner.fish(CONSOLE) as fish:
        radio = Tap(fish)
        gone: list[bytes] = []

        def cut(data: bytes) -> bool:
            if data[7] == 0 and data[8] == 1:
                gone.append(data)
                radio.on_read = lambda _: b""
            return len(gone) < 2

        radio.on_write = cut
        with pytest.raises(LinkLostError, match="did not say whether it took the key"):
            set_key(fish)
    assert gone
    with owner.fish() as fish:
        fish.params.set("ILC_LEAD", 3)
        assert fish.link.signing.key is not None
        assert fish.link.signing.key.key == owner.key().key


# A second computer


def test_the_key_goes_to_a_second_laptop(
    owner: Laptop, laptop: Callable[[str], Laptop], tmp_path: Path
) -> None:
    second, file = laptop("second"), tmp_path / "fish.key"
    line = owner.text("board", "key", "export", str(file))
    assert "whoever has it can move the tail" in line
    if sys.platform != "win32":
        assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert "exists" in owner.fails("board", "key", "export", str(file))
    assert REFUSED in second.fails("board", "arm", "--connect", "radio")
    assert f"delete {file}" in second.text("board", "key", "import", str(file))
    assert second.key().link_id != owner.key().link_id
    assert second.text("params", "set", "ILC_LEAD", "2", "--connect", "radio")
    assert owner.text("params", "set", "ILC_LEAD", "3", "--connect", "radio")
    second.text("board", "key", "delete", second.key().fingerprint)
    assert REFUSED in second.fails("board", "arm", "--connect", "radio")


def test_export_prints_the_secret_and_says_so(owner: Laptop, capsys: Any) -> None:
    status, out, err = owner.call("board", "key", "export")
    assert (status, json.loads(out)["key"]) == (0, owner.key().key.hex())
    assert "secret" in err
    assert err.count("\n") == 1


def test_import_of_something_else(owner: Laptop, tmp_path: Path) -> None:
    (tmp_path / "no.key").write_text("no")
    assert "holds no key" in owner.fails("board", "key", "import", str(tmp_path / "no.key"))
    assert "cannot use" in owner.fails("board", "key", "import", str(tmp_path / "none.key"))


def copy(owner: Laptop, other: Laptop) -> None:
    KeyStore(other.folder).add(owner.key())


def test_two_laptops_at_once(owner: Laptop, laptop: Callable[[str], Laptop]) -> None:
    second = laptop("second")
    copy(owner, second)
    with owner.fish() as radio, second.fish(CONSOLE) as wire:
        for number in range(20):
            radio.params.set("ILC_GAIN", 1.0 + number)
            assert wire.params.get("ILC_GAIN").value == 1.0 + number
            wire.params.set("ILC_LEAD", number % 4)
            assert radio.params.get("ILC_LEAD").value == number % 4
        assert radio.health()["refused_stale"] == 0


def test_two_programs_on_one_laptop(owner: Laptop) -> None:
    with owner.fish() as radio, owner.fish(CONSOLE) as wire:
        for number in range(10):
            radio.params.set("ILC_GAIN", 1.0 + number)
            wire.params.set("ILC_LEAD", number % 4)
            assert radio.params.get("ILC_LEAD").value == number % 4
            assert radio.status().state == wire.status().state == "IDLE"


@pytest.mark.parametrize("year", [1970, 2015, 2100])
def test_a_laptop_whose_clock_is_wrong(
    owner: Laptop, laptop: Callable[[str], Laptop], monkeypatch: pytest.MonkeyPatch, year: int
) -> None:
    """Neither using nor setting a key needs the right time."""
    second = laptop("second")
    copy(owner, second)
    now_s = (year - 1970) * 365.25 * 86400
    monkeypatch.setattr("tailbeat.board.provision.time.time", lambda: now_s)
    with second.fish(CONSOLE) as fish:
        fish.params.set("ILC_LEAD", 1)
        set_key(fish, now_s=lambda: now_s)
        fish.params.set("ILC_LEAD", 2)
        assert fish.health()["refused_stale"] == 0
    assert second.text("params", "set", "ILC_LEAD", "3", "--connect", "radio")


# What a stranger gets


CHANGES = [
    ["board", "arm"], ["board", "disarm"], ["board", "clear"],
    ["learn"], ["learn", "--restore-best"],
    ["params", "set", "ILC_LEAD", "1"], ["params", "save"], ["params", "reset"],
    ["reference", "upload", "thesis"], ["trial", "run"], ["trial", "discard"],
    ["board", "key", "set"], ["board", "key", "erase"],
]  # fmt: skip
READS = [
    ["info"], ["params", "list"], ["trial", "list"], ["board", "key", "status"],
    ["params", "get", "ILC_LEAD"],
]  # fmt: skip


def test_a_stranger_changes_nothing(owner: Laptop, laptop: Callable[[str], Laptop]) -> None:
    with owner.fish() as fish:
        record = upload_reference(fish)
        params = fish.params.values()
        run_trial(fish)
    stranger = laptop("stranger")
    flash = owner.board.flash
    for words in CHANGES:
        err = stranger.fails(*words, "--connect", "wire" if "key" in words else "radio")
        assert err.splitlines()[-1].startswith(REFUSED), words
        assert err.count("\n") == (1 if "key" in words else 2), words
    assert owner.board.flash == flash
    with owner.fish() as fish:
        assert fish.params.values() == params
        assert fish.reference_record() == record
        assert fish.status().pending_trial == 1
        assert int(fish.health()["refused_unsigned"]) > 0


def test_a_stranger_reads(owner: Laptop, laptop: Callable[[str], Laptop], tmp_path: Path) -> None:
    with owner.fish() as fish:
        record = upload_reference(fish)
        number = run_trial(fish).number
        log = fish.ftp.read(f"/trials/{number:04d}.ulg")
    stranger = laptop("stranger")
    for words in READS:
        status, out, err = stranger.call(*words, "--connect", "radio", "--json")
        assert status == 0, (words, err)
        assert json.loads(out)
        assert err.count("\n") == ("key" not in words)
        assert "key import" in err or "key" in words
    with stranger.fish() as fish:
        assert fish.status().pending_trial == number
        assert fish.reference_record() == record
        assert fish.pull_trial(number, tmp_path).read_bytes() == log
        assert key_status(fish).trust == "missing"


def test_what_info_tells_a_stranger(owner: Laptop, laptop: Callable[[str], Laptop]) -> None:
    """What the board tells by itself; the rest is named."""
    ours = owner.json("info", "--connect", "radio")
    stranger = laptop("stranger")
    status, out, _ = stranger.call("info", "--connect", "radio", "--json")
    theirs = json.loads(out)
    assert status == 0
    assert theirs.keys() == ours.keys()
    untold = {"build_id", "version", "board", "simulated", "unique_id", "imu", "visits"}
    assert {name for name, value in theirs.items() if value is None} == untold
    assert theirs["status"]["state"] == "IDLE"
    assert theirs["status"].keys() == ours["status"].keys()
    assert theirs["health"].keys() == ours["health"].keys()
    _, out, _ = stranger.call("info", "--connect", "radio")
    assert "what it is, and its firmware: only for authenticated hosts" in out
    assert "imu        only for authenticated hosts" in out


def test_a_strangers_doctor_names_the_key(
    owner: Laptop, laptop: Callable[[str], Laptop], monkeypatch: pytest.MonkeyPatch
) -> None:
    stranger = laptop("stranger")
    monkeypatch.setattr(
        "tailbeat.board.diagnostics.evidence.open_transport", stranger.open_transport
    )
    for laptop_, problems in ((owner, []), (stranger, ["key"])):
        status, out, err = laptop_.call("board", "check", "--connect", "radio", "--json")
        checks = json.loads(out)["checks"]
        assert (status, err) == (len(problems), "")
        assert [check["name"] for check in checks if check["status"] == "problem"] == problems


def test_raw_requests_of_a_stranger(owner: Laptop) -> None:
    """Without the tool's own caution: the board refuses, and moves nothing."""
    with owner.fish() as fish:
        upload_reference(fish)
    mav = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    transport = SimTransport(owner.board)
    arm = mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, 0, 0, 0, 0, 0, 0)
    transport.write(arm.pack(mav))
    acks: list[Any] = []
    framer = Framer(mavlink.MAVLink(None))
    for _ in range(20):
        transport.wait(0.05)
        acks += [m for m in framer.push(transport.read()) if m.get_type() == "COMMAND_ACK"]
    assert [ack.result_param2 for ack in acks] == [62]
    with owner.fish() as fish:
        assert fish.status().state == "IDLE"


# Recorded and forged frames


def test_a_recording_is_worthless_after_a_restart(owner: Laptop) -> None:
    with owner.fish() as fish:
        radio = Tap(fish)
        upload_reference(fish)
        fish.params.set("ILC_GAIN", 9.0)
        fish.params.save()
        fish.arm()
        fish.disarm()
        fish.params.set("ILC_GAIN", 5.0)
        fish.params.save()
        recorded = list(radio.sent)
    for restart in (False, True):
        if restart:
            owner.board.world.power_cycle()
        transport = SimTransport(owner.board)
        transport.wait(2.0)
        transport.read()
        for frame in recorded:
            transport.write(frame)
            transport.wait(0.05)
        states = {
            m.state
            for m in Framer(mavlink.MAVLink(None)).push(transport.read())
            if m.get_type() == "TAILBEAT_STATUS"
        }
        assert states <= {1}  # IDLE
        with owner.fish() as fish:
            assert fish.params.get("ILC_GAIN").value == 5.0
            assert int(fish.health()["refused_stale"]) > 5


def test_a_board_that_restarts_is_followed(owner: Laptop) -> None:
    with owner.fish() as fish:
        for number in range(4):
            owner.board.world.power_cycle()
            fish.params.set("ILC_LEAD", number)
            owner.board.world.power_cycle()
            upload_reference(fish)
            owner.board.world.power_cycle()
            fish.disarm()
    assert owner.board.time_s > 0


def test_a_spoofed_status_fools_nobody(owner: Laptop) -> None:
    """Somebody answers instead of the board: unsigned, with another key, with old frames."""
    with owner.fish() as fish:
        real = fish.status()
        radio = Tap(fish)
        framer = Framer(mavlink.MAVLink(None))
        heard: list[bytes] = []
        liar = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        forger = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        forger.signing.secret_key, forger.signing.sign_outgoing = b"x" * 32, True
        forger.signing.timestamp = signing_time(9e9)

        def read(received: bytes) -> bytes:
            ack = mavlink.MAVLink_command_ack_message(400, 0)
            data = b""
            for message in framer.push(received):
                heard.append(bytes(message.get_msgbuf()))
                data += heard[len(heard) // 2] + ack.pack(liar) + ack.pack(forger) + heard[-1]
            return data or ack.pack(liar)

        radio.on_read = read
        with pytest.raises(Refused, match="no reference"):
            fish.arm()
        assert fish.status().state == real.state
        radio.on_read = lambda _: read(b"")  # the real board is out of reach
        with pytest.raises(LinkLostError, match="is rejected") as lost:
            fish.arm()
        assert "key status" in lost.value.remedy


def test_a_board_that_lost_its_key_is_told(owner: Laptop, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "tailbeat.board.provision._SHORT_LIVED", ()
    )  # this board stands for a real one
    key = owner.key()
    owner.board.flash = b"\xff" * FLASH_BYTES
    owner.board.world.power_cycle()
    status, _, err = owner.call("params", "list", "--connect", "radio")
    assert status == 0
    assert f"this computer has its key {key.fingerprint}" in err
    assert err.count("\n") == 1
    lost = owner.json("board", "key", "status", "--connect", "radio")
    assert (lost["trust"], lost["lost"]["key"]) == ("open", key.fingerprint)


def test_a_simulated_board_may_forget_its_key(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The next simulator is not taken for a board that lost it; by TCP neither."""
    with Fish.connect("sim?port=console") as fish:
        set_key(fish)
    assert KeyStore()
    for words in (["info"], ["board", "key", "status"], ["board", "check"]):
        status = run([*words, "--connect", "sim", "--json"])
        out, err = capsys.readouterr()
        assert (status, err, 'lost": {' in out) == (0, "", False), words
    monkeypatch.setattr("tailbeat.board.provision.in_process", lambda transport: None)
    with Fish.connect("sim") as fish:
        assert connect_notice(fish) is None


def test_the_emulated_boards_id_is_known() -> None:
    assert emulated.ID_PREFIX.hex().startswith(_SHORT_LIVED)


def test_the_key_comes_back_after_flashing(owner: Laptop) -> None:
    """And what was recorded before is still worthless."""
    with owner.fish() as fish:
        radio = Tap(fish)
        fish.params.set("ILC_GAIN", 9.0)
        recorded = list(radio.sent)
    owner.board.flash = b"\xff" * FLASH_BYTES
    owner.board.world.power_cycle()
    with owner.fish(CONSOLE) as fish:
        assert give_back(fish, "ff" * 16) is None
        given = give_back(fish, owner.key().board, now_s=lambda: 0.0)
        assert given is not None
        assert given.key == owner.key().key
        assert connect_notice(fish) is None
    transport = SimTransport(owner.board)
    for frame in recorded:
        transport.write(frame)
        transport.wait(0.05)
    with owner.fish() as fish:
        assert fish.params.get("ILC_GAIN").value == fish.params.get("ILC_GAIN").default


# At connect


def test_the_wired_port_of_a_board_in_this_process() -> None:
    with Fish.connect("sim?port=console&seed=3") as fish:
        set_key(fish)
    for url in ("sim", "sim?port=radio"):
        with Fish.connect(url) as fish, pytest.raises(Refused, match="USB serial"):
            set_key(fish)


def test_notices_at_connect(
    laptop: Callable[[str], Laptop], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A simulated board moves no tail; any other without a key is told."""
    owner = laptop("owner")
    with owner.fish() as fish:
        assert connect_notice(fish) is None
        monkeypatch.setattr("tailbeat.board.provision.in_process", lambda transport: None)
        assert connect_notice(fish) is None, "nor by TCP"
        monkeypatch.setattr("tailbeat.board.provision._SHORT_LIVED", ())  # it stands for a real one
        notice = connect_notice(fish)
        assert notice is not None
        assert notice.startswith("no key: anyone in Bluetooth range can move this tail")
        assert "tailbeat board key set" in notice


def test_no_key_is_told_once_a_day(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("tailbeat.board.provision.in_process", lambda transport: None)
    monkeypatch.setattr("tailbeat.board.provision._SHORT_LIVED", ())  # it stands for a real one
    monkeypatch.setenv("TAILBEAT_LOGBOOK", str(tmp_path / "logbook"))

    def is_told() -> bool:
        assert run(["params", "get", "ILC_LEAD", "--connect", "sim?seed=1"]) == 0
        return "no key: anyone in Bluetooth range" in capsys.readouterr().err

    assert [is_told(), is_told()] == [True, False]
    (day,) = (tmp_path / "logbook").glob("*/no-key-told")
    day.write_text("2001-01-01")
    assert [is_told(), is_told()] == [True, False]
    day.write_bytes(b"\xff")
    assert is_told()
    (tmp_path / "file").touch()
    monkeypatch.setenv("TAILBEAT_LOGBOOK", str(tmp_path / "file"))
    assert [is_told(), is_told()] == [True, True], "no trial library is no reason to fail"


def test_a_lost_key_is_told_every_time(
    owner: Laptop, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("tailbeat.board.provision._SHORT_LIVED", ())
    monkeypatch.setenv("TAILBEAT_LOGBOOK", str(tmp_path))
    owner.board.flash = b"\xff" * FLASH_BYTES
    owner.board.world.power_cycle()
    for _ in range(2):
        _, _, err = owner.call("params", "get", "ILC_LEAD", "--connect", "radio")
        assert "this computer has its key" in err


def test_a_board_behind_a_bad_line_is_in_this_process() -> None:
    with Fish.connect("sim?line=drop=0.02") as fish:
        assert connect_notice(fish) is None


def test_a_key_others_can_read_is_told(owner: Laptop, monkeypatch: pytest.MonkeyPatch) -> None:
    (path,) = owner.folder.glob("*.json")
    path.chmod(0o644)
    _, _, err = owner.call("params", "get", "ILC_LEAD", "--connect", "radio")
    assert f"chmod 600 {path}" in err
    assert err.count("\n") == 1


# A whole session


def test_a_signed_trial_is_learned_from(owner: Laptop) -> None:
    with owner.fish() as fish:
        fish.params.set("ILC_LEAD", 1)
        fish.params.set("DU_MAX_RAD", 0)
        upload_reference(fish)
        errors = []
        for number in (1, 2, 3):
            outcome = run_trial(fish)
            assert (outcome.number, outcome.end) == (number, "complete")
            assert all(beat.speed_m_s is not None for beat in outcome.beats)
            errors.append(fish.learn().rms_error_m_s)
        assert errors[2] < errors[0]
        counted = fish.health()
        assert [counted[f"refused_{why}"] for why in ("unsigned", "wrong", "stale")] == [0, 0, 0]


def test_a_trial_whose_board_comes_back_without_its_key(owner: Laptop) -> None:
    """It is not waited for: nothing that comes from it will be believed."""
    with owner.fish() as fish:
        upload_reference(fish)
        cut_at_s: list[float] = []

        def erase(event: dict[str, Any]) -> None:
            if isinstance(event, BeatEvent) and not cut_at_s:
                cut_at_s.append(owner.board.time_s)
                owner.board.flash = b"\xff" * FLASH_BYTES
                owner.board.world.power_cycle()

        with pytest.raises(LinkLostError, match="not signed any more: its key was erased"):
            run_trial(fish, on_event=erase)
        assert owner.board.time_s - cut_at_s[0] < 20.0


@pytest.mark.parametrize("hole_s", [20.0, 60.0])
def test_frames_of_others_do_not_end_the_waiting(owner: Laptop, hole_s: float) -> None:
    """Some forged frames in a hole of the radio; they are told if it was too long."""
    with owner.fish() as fish:
        radio = Tap(fish)
        upload_reference(fish)
        liar = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        forged = bytes(mavlink.MAVLink_heartbeat_message(1, 0, 0, 0, 0, 3).pack(liar))
        due_s = [4.0, 6.0, 8.0, 12.0, 14.0]
        hole: list[float] = []

        def read(data: bytes) -> bytes:
            if not hole or owner.board.time_s > hole[0] + hole_s:
                return data
            if not due_s or owner.board.time_s < hole[0] + due_s[0]:
                return b""
            del due_s[0]
            return forged

        def begin(event: dict[str, Any]) -> None:
            if isinstance(event, BeatEvent) and not hole:
                hole.append(owner.board.time_s)

        radio.on_read = read
        if hole_s > 30.0:
            with pytest.raises(LinkLostError, match="come back in 30 s: what comes from it is not"):
                run_trial(fish, on_event=begin, reconnect_s=30.0)
        else:
            assert run_trial(fish, on_event=begin, reconnect_s=30.0).end == "complete"
        assert not due_s
