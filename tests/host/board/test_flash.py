"""Flashing: the whole procedure against fakes of bossac, OpenOCD, the USB ports and the board."""

from __future__ import annotations

import json
import stat
import struct
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tailbeat.app.cli import run as run_command
from tailbeat.board.fish import Fish
from tailbeat.board.flash.backup import key_warning
from tailbeat.board.flash.ports import BoardPort
from tailbeat.board.flash.procedure import FlashError, FlashPlan, FlashReport, Surroundings, flash
from tailbeat.board.flash.programs import ProgramResult, run_program
from tailbeat.board.provision import HELD, OPEN, set_key, trust_of
from tailbeat.board.snapshot import Snapshot, restore
from tailbeat.core import records
from tailbeat.core.errors import ConnectError, InputError, TailbeatError
from tailbeat.core.faults import BAD_FORMAT, WRONG_STATE, refusal
from tailbeat.experiment.folder import Experiment, backup_places
from tailbeat.link import _dialect as mavlink
from tailbeat.link.keystore import KeyStore
from tailbeat.link.serial import USB_IDS, PortKind
from tailbeat.link.transport import START_LINE
from tailbeat.session.trial import run_trial
from tailbeat.sim.board import CONSOLE, FLASH_BYTES, RADIO, SimBoard, SimTransport

ACM, USB, CLONE = "/dev/ttyACM0", "/dev/ttyACM1", "/dev/ttyUSB0"

Command = Callable[..., tuple[int, str, str]]

# Both fakes read and change the chip's state in a file beside them. What they model of the chip:
# whatever opens the programming port resets it, and a reset that comes with the setting of the boot
# bit loses the bit.
FAKE = """#!{python}
import json, pathlib, sys
file = pathlib.Path({chip!r})
chip = json.loads(file.read_text())
arguments = sys.argv[1:]
chip["calls"].append([pathlib.Path(sys.argv[0]).name, *arguments])

def end(status, text):
    file.write_text(json.dumps(chip))
    print(text)
    sys.exit(status)

def reset():
    chip["mode"] = "firmware" if chip["boot"] and chip["image"] else "loader"

def write(path):
    chip["image"] = pathlib.Path(path).read_bytes().hex()
"""
BOSSAC = """
usb = chip["port"] == "ttyACM1"
if not usb:
    reset()
if arguments[:2] != ["--port=" + chip["port"], f"-U{int(usb)}"] or chip["mode"] != "loader":
    end(1, "No device found on " + arguments[0])
flags = arguments[2:]
if "-i" in flags:
    end(0, "Device : ATSAM3X8")
if "-w" in flags and "write" in chip["broken"]:
    end(2, "[==] 100%\\nVerify failed\\nPage errors: 1\\nByte errors: 1")
if "-e" in flags:
    chip.update(image=None, stored=False)
if "-w" in flags:
    write(flags[-1])
if "-b" in flags:
    chip["boot"] = "-R" not in flags
if "-R" in flags:
    reset()
end(0, "Set boot flash true")
"""
OPENOCD = """
if "write" in chip["broken"]:
    end(1, "Error: unable to find a matching CMSIS-DAP device\\n1: dummy\\n2: jlink")
commands = dict(zip(arguments[4::2], arguments[5::2]))
steps = commands["-c"].split("; ")
write(steps[2].split("{")[1].split("}")[0])
chip["boot"] = "at91sam3 gpnvm set 1" in steps
reset()
end(0, "** Verified OK **")
"""


@dataclass
class Listed:
    device: str
    vid: int | None
    pid: int | None


IDS = {kind: ids for ids, kind in USB_IDS.items()}


def listed(device: str, kind: PortKind) -> Listed:
    return Listed(device, *IDS[kind])


def damaged_heartbeat() -> bytes:
    """A board's frame with a wrong checksum."""
    frame = bytearray(
        mavlink.MAVLink_heartbeat_message(12, 0, 0, 0, 3, 3).pack(
            mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        )
    )
    frame[-1] ^= 0x55
    return bytes(frame)


class DeadTransport:
    """A port behind which no board answers."""

    def __init__(self, name: str, sends: bytes = b"") -> None:
        self.name = name
        self._now_s = 0.0
        self._sends = sends

    def read(self) -> bytes:
        """What another program, or firmware that hangs, sends after a reset."""
        sent, self._sends = self._sends, b""
        return sent

    def write(self, data: bytes) -> None:
        """Nobody hears it."""

    def wait(self, timeout_s: float) -> None:
        self._now_s += max(timeout_s, 1e-3)

    def now_s(self) -> float:
        return self._now_s

    def reopen(self) -> None:
        """Stays dead."""

    def close(self) -> None:
        """Was never open."""


@dataclass
class Due:
    """A board with its USB ports, as the computer sees them."""

    folder: Path
    board: SimBoard = field(default_factory=lambda: SimBoard("tank"))
    ports: list[Listed] = field(default_factory=lambda: [listed(ACM, PortKind.PROGRAMMING)])
    users: list[str] = field(default_factory=list)
    steps: list[tuple[float, str]] = field(default_factory=list)
    touched: list[str] = field(default_factory=list)
    on_touch: Callable[[], None] = lambda: None
    now_s: float = 0.0
    away_until_s: float = 0.0
    on_open: Callable[[], None] = lambda: None
    on_radio: SimBoard | None = None
    reachable: tuple[str, ...] = (ACM, CLONE, "radio")
    sends: bytes = b""
    pressed_at_s: float | None = None  # when somebody presses ERASE and RESET

    def __post_init__(self) -> None:
        self.state(mode="firmware", boot=True, image="00", stored=True, port="ttyACM0",
                   broken=[], calls=[])  # fmt: skip
        for name, body in (("bossac", BOSSAC), ("openocd", OPENOCD)):
            path = self.folder / "bin" / name
            path.parent.mkdir(exist_ok=True)
            head = FAKE.format(python=sys.executable, chip=str(self.chip_file))
            path.write_text(head + body)
            path.chmod(path.stat().st_mode | stat.S_IXUSR)

    @property
    def chip_file(self) -> Path:
        return self.folder / "chip.json"

    def chip(self) -> dict[str, Any]:
        return dict(json.loads(self.chip_file.read_text()))

    def state(self, **values: Any) -> None:
        old = self.chip() if self.chip_file.exists() else {}
        self.chip_file.write_text(json.dumps(old | values))

    @property
    def calls(self) -> list[list[str]]:
        return list(self.chip()["calls"])

    def enumerate_ports(self) -> list[Listed]:
        return self.ports if self.now_s >= self.away_until_s else []

    def require_free(self, device: str) -> None:
        if self.users:
            raise ConnectError(f"{device} is in use by {', '.join(self.users)}", "Close it.")

    def touch(self, port: BoardPort) -> None:
        self.on_touch()
        self.touched.append(port.device)
        if port.talks:
            self.state(mode="loader", boot=False, image=None, stored=False)
        else:
            self.state(mode="loader", boot=False, port="ttyACM1")
            self.away_until_s = self.now_s + 2.0
            self.ports = [p for p in self.ports if p.device != port.device]
            self.ports.append(listed(USB, PortKind.SAM_BA))

    def sleep(self, duration_s: float) -> None:
        self.now_s += duration_s
        if self.pressed_at_s is not None and self.now_s >= self.pressed_at_s:
            self.pressed_at_s = None
            self.state(mode="loader", boot=False, image=None, stored=False)

    def open_transport(self, url: str | None, **_: float) -> SimTransport | DeadTransport:
        """Opening the programming port resets the chip."""
        self.on_open()
        if url == "radio" and self.on_radio is not None:
            return SimTransport(self.on_radio)
        chip = self.chip()
        if url in (ACM, CLONE):
            chip["mode"] = "firmware" if chip["boot"] and chip["image"] else "loader"
        if url not in self.reachable or chip["mode"] != "firmware" or "boot" in chip["broken"]:
            return DeadTransport(str(url), self.sends)
        if not chip["stored"]:
            self.board.flash = b"\xff" * FLASH_BYTES
            self.state(stored=True)
        self.board.world.power_cycle()
        return SimTransport(self.board, CONSOLE if url in (ACM, CLONE) else RADIO)

    def around(self, **changes: Any) -> Surroundings:
        values: dict[str, Any] = {
            "enumerate_ports": self.enumerate_ports,
            "require_free": self.require_free,
            "touch": self.touch,
            "restart": lambda port: self.sends,
            "sleep": self.sleep,
            "now_s": lambda: self.now_s,
        }
        return Surroundings(**(values | changes))

    def flash(
        self,
        image: Path,
        around: Surroundings | None = None,
        tell: Callable[[str], None] = lambda line: None,
        confirm: Callable[[str], bool] = lambda question: False,
        **plan: Any,
    ) -> FlashReport:
        plan["places"] = backup_places(plan.pop("out", self.folder / "backups"))
        return flash(
            FlashPlan(image, **plan),
            lambda at, text: self.steps.append((at, text)),
            around or self.around(),
            tell,
            confirm,
        )


@pytest.fixture
def due(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Due:
    due = Due(tmp_path)
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("tailbeat.board.fish.open_transport", due.open_transport)
    return due


def image_bytes(build_id: str) -> bytes:
    marked = b"tailbeat build id: " + build_id.encode() + b"\0"
    return struct.pack("<II", 0x20088000, 0x00080101) + bytes(512) + marked


@pytest.fixture
def image(tmp_path: Path) -> Path:
    """An image of the build that the simulated board says it is."""
    with Fish(SimTransport(SimBoard("tank"))) as fish:
        build_id = fish.info().build_id
    for name in ("tailbeat.bin", "tailbeat.elf"):
        (tmp_path / name).write_bytes(image_bytes(build_id))
    return tmp_path / "tailbeat.bin"


@dataclass
class Content:
    """What the tests put onto the board before they flash it."""

    reference: bytes | None
    learned: bytes | None
    params: dict[str, float]
    trials: dict[str, bytes]


@pytest.fixture
def taught(due: Due) -> Content:
    """The board has swum and learned from two trials, with parameters of its own."""
    reference = records.encode_reference(1.0, 0.06 * np.sin(np.linspace(0.2, 2.9, 40)))
    with Fish(SimTransport(due.board)) as fish:
        fish.params.set("ILC_LEAD", 1)
        fish.params.set("SERVO_CENTRE_US", 1512.5)
        fish.params.save()
        fish.upload_reference(reference)
        for _ in range(2):
            fish.learn(run_trial(fish).number)
        return Content(
            reference,
            fish.learned_record(),
            fish.params.values(),
            {f"{t.number:04d}.ulg": fish.ftp.read(t.path) for t in fish.trials()},
        )


def on_board(due: Due) -> Content:
    with Fish(SimTransport(due.board)) as fish:
        return Content(
            fish.reference_record(),
            fish.learned_record(),
            fish.params.values(),
            {f"{t.number:04d}.ulg": fish.ftp.read(t.path) for t in fish.trials()},
        )


WRITE = ["bossac", "--port=ttyACM0", "-U0", "-e", "-w", "-v", "-b"]
START = ["bossac", "--port=ttyACM0", "-U0", "-R"]


# The way it should go


def test_programming_port(due: Due, taught: Content, image: Path) -> None:
    saved_first: list[Path] = []
    due.on_touch = lambda: saved_first.extend((due.folder / "backups").glob("*/board.json"))
    report = due.flash(image)
    assert due.touched == [ACM]
    assert len(saved_first) == 1
    assert due.calls == [[*WRITE, str(image)], START]
    assert due.now_s >= 2.0  # the erase takes time, and so does the boot bit
    assert due.chip()["image"] == image.read_bytes().hex()
    assert report.verified
    assert report.backup == saved_first[0].parent
    assert {p.name: p.read_bytes() for p in report.trials_pulled} == taught.trials
    assert report.restored == [
        f"{len(taught.params)} parameters", "the reference", "all that was learned",
    ]  # fmt: skip
    now = on_board(due)
    assert now.params == taught.params
    assert now.reference == taught.reference
    assert now.learned == taught.learned
    assert now.trials == {}


def test_what_comes_back_lasts(due: Due, taught: Content, image: Path) -> None:
    due.flash(image)
    due.board.world.power_cycle()
    now = on_board(due)
    assert (now.params, now.learned) == (taught.params, taught.learned)


@dataclass
class Older:
    """The image that is flashed knows learned records of version 1 only and counts no visits."""

    monkeypatch: pytest.MonkeyPatch
    took: list[bytes] = field(default_factory=list)

    def begin(self) -> None:
        upload = Fish.upload_learned

        def upload_learned(fish: Fish, record: bytes) -> None:
            if record[4:6] != b"\1\0":
                raise refusal(BAD_FORMAT)
            self.took.append(record)
            upload(fish, record)

        self.monkeypatch.setattr(Fish, "upload_learned", upload_learned)
        self.monkeypatch.setattr("tailbeat.board.memory._VISITS", 99)  # a set that no board knows


def test_an_older_image_gets_what_was_learned_without_the_counts(
    due: Due, taught: Content, image: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as meanwhile:
        older = Older(meanwhile)
        due.on_touch = older.begin
        report = due.flash(image)
    assert taught.learned is not None and any(taught.learned[-40:])
    assert report.restored[-1] == "all that was learned"
    assert report.not_restored == [
        "how often each beat was corrected (this firmware does not count it; the backup has it)"
    ]
    older_form = records.without_peaks(taught.learned)
    assert [record[12:] for record in older.took] == [older_form[12:-40]]
    assert report.backup is not None
    with Fish(SimTransport(due.board)) as fish:
        record = fish.learned_record()
        assert record is not None and record[12:] == older_form[12:-40] + bytes(40)
        back = restore(fish, Snapshot.read(report.backup))  # after the next update
        assert (back.back[-1], back.missing) == ("all that was learned", [])
        assert fish.learned_record() == taught.learned


def test_what_an_older_image_holds_already_is_not_sent_again(
    due: Due, taught: Content, image: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    older = Older(monkeypatch)
    due.on_touch = older.begin
    report = due.flash(image)
    assert report.backup is not None
    with Fish(SimTransport(due.board)) as fish:
        again = restore(fish, Snapshot.read(report.backup))
    assert (again.back[-1], again.missing) == ("all that was learned", report.not_restored)
    assert len(older.took) == 1


def test_another_refusal_is_told_and_not_tried_again(
    due: Due, taught: Content, image: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    offered: list[bytes] = []

    def upload_learned(fish: Fish, record: bytes) -> None:
        offered.append(record)
        raise refusal(WRONG_STATE)

    monkeypatch.setattr(Fish, "upload_learned", upload_learned)
    report = due.flash(image)
    assert offered == [taught.learned]
    assert report.not_restored[0] == "all that was learned (not possible in this state)"


@pytest.fixture
def keyed(due: Due, taught: Content) -> KeyStore:
    """The board has a key, and so has this computer."""
    with Fish(SimTransport(due.board, CONSOLE)) as fish:
        set_key(fish)
    return KeyStore()


@pytest.mark.usefixtures("keyed")
def test_the_key_comes_back(due: Due, taught: Content, image: Path) -> None:
    told: list[str] = []
    report = due.flash(image, tell=told.append)
    assert (report.verified, report.not_restored, told) == (True, [], [])
    assert report.restored[-1] == "its key"
    assert report.backup is not None
    assert Snapshot.read(report.backup).signed
    assert not list(report.backup.rglob("*key*"))
    now = on_board(due)
    assert (now.params, now.learned) == (taught.params, taught.learned)
    with Fish(SimTransport(due.board)) as fish:
        fish.clock.sync()
        assert trust_of(fish) == HELD


def test_the_key_does_not_come_back_by_radio(
    due: Due,
    keyed: KeyStore,
    image: Path,
    command: Command,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    del keyed
    monkeypatch.setattr(
        "tailbeat.board.provision._SHORT_LIVED", ()
    )  # this board stands for a real one
    backup = due.flash(image).backup
    due.board.flash = b"\xff" * FLASH_BYTES
    due.board.world.power_cycle()
    _, out, _ = command("--restore", str(backup), "--connect", "radio")
    assert "not restored: the key (the key can only be set over USB serial)" in out
    status, out, err = command("--restore", str(backup), "--connect", ACM)
    assert (status, err.count("\n")) == (0, 1)
    assert "this computer has its key" in err
    assert out.rstrip().endswith("its key")


def test_a_key_that_went_missing_meanwhile_is_told(due: Due, keyed: KeyStore, image: Path) -> None:
    due.on_touch = lambda: keyed.delete(keyed.find(None))
    report = due.flash(image)
    assert report.not_restored == [
        "the key (not on this computer); set one: tailbeat board key set"
    ]
    with Fish(SimTransport(due.board)) as fish:
        fish.clock.sync()
        assert trust_of(fish) == OPEN


def test_a_stranger_is_warned_before_the_key_goes(due: Due, keyed: KeyStore) -> None:
    keyed.delete(keyed.find(None))
    with Fish(SimTransport(due.board)) as fish:
        fish.clock.sync()
        assert "Flashing erases it" in (key_warning(fish) or "")


def test_learning_goes_on_where_it_was(due: Due, taught: Content, image: Path) -> None:
    report = due.flash(image)
    assert report.not_restored == []
    assert taught.learned is not None
    with Fish(SimTransport(due.board)) as fish:
        status = fish.status()
        assert (status.iteration, status.next_trial, status.last_learned_trial) == (3, 3, 2)
        assert status.best_iteration is not None
        fish.restore_best()
        assert run_trial(fish).number == 3


def test_a_number_that_comes_again_is_said(due: Due, taught: Content, image: Path) -> None:
    with Fish(SimTransport(due.board)) as fish:
        run_trial(fish)
        fish.discard()
    report = due.flash(image)
    assert report.not_restored == [
        "the trial numbers: the next is 3, not 4; begin a new experiment folder"
    ]
    assert on_board(due).learned == taught.learned


@pytest.mark.usefixtures("taught")
def test_progress_only_grows(due: Due, image: Path) -> None:
    due.flash(image)
    fractions = [at for at, _ in due.steps]
    assert fractions == sorted(fractions)
    assert {"erasing", "writing and verifying", "restoring"} <= {text for _, text in due.steps}


def test_an_empty_board(due: Due, image: Path) -> None:
    report = due.flash(image)
    assert report.verified
    assert (report.not_restored, report.notes, report.trials_pulled) == ([], [], [])
    assert [what.split()[1] for what in report.restored] == ["parameters"]


@pytest.mark.usefixtures("taught")
def test_trials_pulled_before_are_not_pulled_again(due: Due, image: Path) -> None:
    known = Experiment.new(Path("experiments"), "fish", "r", "p4")
    other = Experiment.new(Path("experiments"), "another", "r", "p4")
    with Fish(SimTransport(due.board)) as fish:
        logs = {t.number: fish.ftp.read(t.path) for t in fish.trials()}
    known.add_raw("0001.ulg", logs[1])
    other.add_raw("0002.ulg", logs[2][:-1] + b"\x77")  # as long, of another fish
    report = due.flash(image)
    assert [path.name for path in report.trials_pulled] == ["0002.ulg"]


def test_trials_into_an_experiment(due: Due, taught: Content, image: Path) -> None:
    experiment = Experiment.new(due.folder / "e", "fish", "r", "p4")
    experiment.add_raw("0002.ulg", b"of another board")
    report = due.flash(image, out=experiment.folder)
    assert report.backup is not None
    assert report.backup.parent == experiment.folder / "backups"
    places = [experiment.raw / "0001.ulg", report.backup / "trials" / "0002.ulg"]
    assert report.trials_pulled == places
    assert [path.read_bytes() for path in places] == list(taught.trials.values())
    assert experiment.damaged() == []


@pytest.mark.usefixtures("taught")
def test_native_port(due: Due, image: Path) -> None:
    due.ports = [listed(USB.replace("1", "7"), PortKind.NATIVE)]
    report = due.flash(image, connect="radio")
    assert due.touched == ["/dev/ttyACM7"]
    assert due.now_s >= 2.0  # it left and came back under another name
    start = ["bossac", "--port=ttyACM1", "-U1", "-R"]
    assert due.calls == [[*start[:3], "-e", "-w", "-v", "-b", str(image)], start]
    assert report.verified
    assert "all that was learned" in report.restored


def test_the_loader_of_another_board_is_left_alone(due: Due, image: Path) -> None:
    other = listed("/dev/ttyACM0", PortKind.SAM_BA)
    due.ports = [other, listed("/dev/ttyACM7", PortKind.NATIVE)]
    assert due.flash(image, port="/dev/ttyACM7", connect="radio").verified
    assert {call[1] for call in due.calls} == {"--port=ttyACM1"}


def test_native_port_alone_is_a_sketch_and_has_nothing_to_keep(due: Due, image: Path) -> None:
    due.ports = [listed(USB.replace("1", "7"), PortKind.NATIVE)]
    report = due.flash(image)
    assert due.touched == ["/dev/ttyACM7"]
    assert (report.verified, report.backup) == (False, None)
    assert "another program than tailbeat" in report.notes[0]
    assert report.notes[1].startswith("the board was not asked which build it runs")


@pytest.mark.parametrize(
    "sends",
    [b"", b"Hello from a sketch\r\n", b"\x80", bytes(range(128, 200))],
    ids=["silence", "text", "noise", "another speed"],
)
def test_a_due_with_a_sketch_is_flashed_without_a_flag(due: Due, image: Path, sends: bytes) -> None:
    """As it comes from the factory."""
    due.sends = sends
    due.state(broken=["boot"])
    due.on_touch = lambda: due.state(broken=[])
    report = due.flash(image)
    assert report.verified
    assert (report.backup, due.touched) == (None, [ACM])
    assert report.notes == [
        f"{ACM}: the board runs another program than tailbeat, or none: nothing to save"
    ]


# Clones and custom boards: a port that is named


def clone(due: Due, vendor: int | None) -> None:
    due.ports = [Listed(CLONE, vendor, None if vendor is None else 0x7523)]
    due.state(port="ttyUSB0")


@pytest.mark.parametrize("vendor", [0x1A86, None], ids=["CH340", "no USB"])
def test_a_clone_is_erased_by_hand(
    due: Due, taught: Content, image: Path, vendor: int | None
) -> None:
    clone(due, vendor)
    due.pressed_at_s = 5.0
    told: list[str] = []
    report = due.flash(image, port=CLONE, tell=told.append, confirm=lambda question: True)
    assert told == [
        f"{CLONE} cannot erase the board. Hold the board's ERASE button for at least 1 s, release"
        " it, and press RESET. Waiting 120 s for the boot loader."
    ]
    assert due.touched == []
    assert report.verified
    assert on_board(due).learned == taught.learned


@pytest.mark.parametrize("answer", [True, False])
def test_an_unknown_port_is_touched_only_after_a_question(
    due: Due, taught: Content, image: Path, answer: bool
) -> None:
    clone(due, 0x1B4F)
    due.pressed_at_s = None if answer else 5.0
    asked: list[str] = []

    def confirm(question: str) -> bool:
        assert due.touched == []
        asked.append(question)
        return answer

    assert due.flash(image, port=CLONE, confirm=confirm).verified
    assert due.touched == ([CLONE] if answer else [])
    (question,) = asked
    assert question.startswith(f"{CLONE} has the USB ids 1b4f:7523, which are not a Due's.")
    assert on_board(due).learned == taught.learned


def test_nobody_presses_the_buttons(due: Due, image: Path) -> None:
    clone(due, 0x1A86)
    with pytest.raises(FlashError, match="boot loader did not answer on /dev/ttyUSB0 within 120"):
        due.flash(image, port=CLONE)


def test_a_clone_that_was_erased_already(due: Due, image: Path) -> None:
    clone(due, 0x1A86)
    due.state(mode="loader", boot=False, image=None, stored=False)
    told: list[str] = []
    assert due.flash(image, port=CLONE, tell=told.append).verified
    assert told == []


def test_loader_that_waits_on_usb(due: Due, image: Path) -> None:
    due.ports = [listed(USB, PortKind.SAM_BA)]
    due.state(mode="loader", boot=False, port="ttyACM1")
    report = due.flash(image)
    assert due.touched == []
    assert [call[-1] for call in due.calls] == [str(image), "-R"]
    assert "boot loader" in report.notes[0]


def test_a_new_board_needs_no_flag(due: Due, image: Path) -> None:
    due.state(mode="loader", boot=False, image=None, stored=False)
    report = due.flash(image)
    assert due.calls[0] == [*WRITE[:3], "-i"]
    assert report.verified
    assert report.backup is None
    assert "nothing to save" in report.notes[0]


@pytest.mark.usefixtures("taught")
def test_no_keep_does_not_ask(due: Due, image: Path) -> None:
    report = due.flash(image, keep=False)
    assert report.verified
    assert (report.backup, report.restored) == (None, [])
    assert not (due.folder / "backups").exists()
    assert report.notes == ["nothing was saved from the board (--no-keep)"]


def test_openocd_loses_nothing(due: Due, taught: Content, image: Path) -> None:
    report = due.flash(image, tool="openocd")
    assert due.touched == []
    (call,) = due.calls
    elf = image.with_suffix(".elf")
    assert call == [
        "openocd", "-c", "adapter driver cmsis-dap", "-c", "transport select swd",
        "-f", "target/at91sam3ax_8x.cfg", "-c",
        f"init; reset halt; program {{{elf}}} verify; at91sam3 gpnvm set 1;"
        " at91sam3 gpnvm show; reset run; shutdown",
    ]  # fmt: skip
    assert report.verified
    assert report.backup is not None
    assert report.not_restored == []
    assert on_board(due) == taught


def test_openocd_without_any_port(due: Due, image: Path) -> None:
    due.ports = []
    assert due.flash(image, tool="openocd", connect="radio", adapter="jlink").verified
    assert due.calls[0][2:5] == ["adapter driver jlink", "-c", "transport select swd"]
    due.flash(image, tool="openocd", connect="radio", adapter="st-link")
    assert due.calls[1][2:5] == ["adapter driver st-link", "-c", "transport select dapdirect_swd"]
    report = due.flash(image, tool="openocd", keep=False)
    assert (report.port, report.verified) == (None, False)


# What is refused before anything is touched


def untouched(due: Due, image: Path, **plan: Any) -> TailbeatError:
    with pytest.raises(TailbeatError) as refused:
        due.flash(image, **plan)
    assert not isinstance(refused.value, FlashError)
    assert "ERASE" not in refused.value.remedy
    assert refused.value.remedy
    assert due.touched == []
    assert [call for call in due.calls if "-w" in call or call[0] == "openocd"] == []
    return refused.value


@pytest.mark.parametrize("sends", [START_LINE + b"\r\n", damaged_heartbeat()])
def test_a_board_whose_firmware_hangs(due: Due, image: Path, sends: bytes) -> None:
    due.sends = sends
    due.state(broken=["boot"])
    error = untouched(due, image)
    assert "does not answer, so what it holds cannot be saved" in error.message
    assert "--no-keep" in error.remedy


def test_a_hang_that_only_a_certain_reset_shows(due: Due, image: Path) -> None:
    """Opening the port need not reset the board; the rise of DTR does."""
    due.state(broken=["boot"])
    due.on_open = lambda: setattr(due, "sends", b"")
    around = due.around(restart=lambda port: START_LINE + b"\r\n")
    with pytest.raises(ConnectError, match="starts, but then does not answer, so what it") as why:
        due.flash(image, around)
    assert "--no-keep" in why.value.remedy
    assert due.touched == []


def test_silence_elsewhere_is_no_proof(due: Due, image: Path) -> None:
    """On the radio nothing resets the board; on a clone's port perhaps nothing does."""
    due.state(broken=["boot"])
    assert "cannot be saved" in untouched(due, image, connect="radio").message
    clone(due, 0x1A86)
    with pytest.raises(ConnectError, match="no tailbeat board answers") as refused:
        due.flash(image, port=CLONE)
    assert refused.value.remedy.endswith("and press RESET. Then run the same command again.")
    assert due.touched == []


def test_a_port_that_may_not_be_opened(
    due: Due, image: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(url: str | None) -> SimTransport:
        raise ConnectError(f"cannot open {url} (Permission denied)", "Join the group dialout.")

    monkeypatch.setattr("tailbeat.board.fish.open_transport", refused)
    due.state(mode="firmware")
    assert untouched(due, image).remedy.startswith("Join the group dialout. If its firmware hangs")


@pytest.mark.usefixtures("taught")
def test_a_board_that_is_armed(due: Due, image: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(due.board.world, "power_cycle", lambda: None)  # as over the radio
    with Fish(SimTransport(due.board)) as fish:
        fish.arm()
    error = untouched(due, image, connect="radio")
    assert str(error) == (
        "the board is ARMED; it is not flashed while the tail may move."
        " Stop it first: tailbeat board disarm"
    )


@pytest.mark.usefixtures("taught")
def test_a_pending_trial(due: Due, image: Path) -> None:
    with Fish(SimTransport(due.board)) as fish:
        run_trial(fish)
    error = untouched(due, image)
    assert error.message.startswith("trial 3 was executed but not learned from")
    assert due.flash(image, tool="openocd").verified  # it does not touch the store


def test_a_low_battery(due: Due, image: Path) -> None:
    due.board.world.set_battery_v(5.5)
    assert "5.50 V, below BATT_CRIT_V (6 V)" in untouched(due, image).message
    due.board.world.set_battery_v(0.1)
    assert due.flash(image).verified  # on USB power there is no battery


def test_a_port_in_use(due: Due, image: Path) -> None:
    due.users = ["picocom (123)"]
    assert "in use by picocom (123)" in untouched(due, image).message


@pytest.mark.usefixtures("taught")
def test_a_port_that_is_taken_while_the_board_is_saved(due: Due, image: Path) -> None:
    due.on_open = lambda: due.users.append("ModemManager (7)")
    assert "in use by ModemManager (7)" in untouched(due, image).message


def test_another_board_on_the_radio_than_on_the_port(due: Due, image: Path) -> None:
    due.on_radio = SimBoard("tank", 2)
    error = untouched(due, image, connect="radio")
    assert error.message.startswith("the board on /dev/ttyACM0 (73696d2d66697368")
    assert "is not the one on radio (73696d2d66697368" in error.message
    due.state(broken=["boot"])
    error = untouched(due, image, connect="radio")
    assert "(silent: there is no tailbeat board on /dev/ttyACM0) is not the one" in error.message


def test_the_same_board_on_the_radio(due: Due, taught: Content, image: Path) -> None:
    assert due.flash(image, connect="radio").verified
    assert on_board(due).learned == taught.learned


def test_programs_that_are_missing(due: Due, image: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(due.folder / "nothing"))
    error = untouched(due, image)
    assert str(error) == "the program bossac is missing. Install it: apt-get install bossa-cli"
    assert "apt-get install openocd" in untouched(due, image, tool="openocd").remedy


def test_an_elf_of_another_build(due: Due, image: Path) -> None:
    image.with_suffix(".elf").write_bytes(image_bytes("0.1.0-other"))
    assert "different builds" in untouched(due, image, tool="openocd").message
    image.with_suffix(".elf").unlink()
    assert "tailbeat.elf (No such file" in untouched(due, image, tool="openocd").message


@pytest.mark.usefixtures("taught")
def test_a_backup_that_cannot_be_written(due: Due, image: Path) -> None:
    taken = due.folder / "taken"
    taken.write_text("a file")
    with pytest.raises(OSError):
        due.flash(image, out=taken)
    assert due.touched == []


# What fails after the erase


def broken(due: Due, image: Path, around: Surroundings | None = None, **plan: Any) -> FlashError:
    with pytest.raises(FlashError) as failed:
        due.flash(image, around, **plan)
    return failed.value


@pytest.mark.usefixtures("taught")
def test_a_write_that_fails(due: Due, image: Path) -> None:
    due.state(broken=["write"])
    error = broken(due, image)
    (backup,) = (due.folder / "backups").iterdir()
    assert str(error) == (
        "bossac could not write the image: the flash holds something else than was written"
        " (Byte errors: 1)."
        " Hold the board's ERASE button for at least 1 s, release it, press RESET, and run the same"
        " command again. What the board held goes back with: tailbeat board flash --restore "
        f"{backup}"
    )


@pytest.mark.usefixtures("taught")
def test_the_advice_works(due: Due, taught: Content, image: Path) -> None:
    due.state(broken=["write"])
    broken(due, image)
    (folder,) = (due.folder / "backups").iterdir()
    due.state(broken=[], mode="loader", boot=False, image=None, stored=False)
    assert due.flash(image).verified
    assert run_command(["board", "flash", "--restore", str(folder), "--connect", ACM]) == 0
    assert on_board(due).learned == taught.learned


def test_an_image_that_does_not_start(due: Due, image: Path) -> None:
    due.on_touch = lambda: due.state(broken=["boot"])
    error = broken(due, image)
    assert "the image was written, but the board does not answer" in error.message
    assert "press RESET" in error.remedy


def test_one_call_to_bossac_would_not_boot(due: Due, image: Path) -> None:
    """The trap that the two calls avoid: the fake behaves as bossac 1.9 does."""

    def in_one_call(command: Sequence[str], timeout_s: float) -> ProgramResult:
        joined = [*command[:-1], "-R", command[-1]] if "-b" in command else command
        return run_program(joined, timeout_s)

    assert "does not answer" in broken(due, image, due.around(run=in_one_call)).message


def test_another_build_runs(due: Due, image: Path) -> None:
    image.write_bytes(image_bytes("0.1.0-abcdef1"))
    error = broken(due, image)
    assert "but the image is 0.1.0-abcdef1" in error.message


def test_another_board_answers(due: Due, image: Path) -> None:
    other = SimBoard("tank", 2)

    def swap() -> None:
        due.board = other

    due.on_touch = swap
    assert "is not the one that was saved" in broken(due, image).message


@pytest.mark.usefixtures("taught")
def test_another_board_was_erased(due: Due, image: Path) -> None:
    """Only the native port of one board is plugged in, and another is spoken to."""
    due.ports = [listed(USB.replace("1", "7"), PortKind.NATIVE)]
    due.on_radio = due.board
    error = broken(due, image, connect="radio")
    assert error.message == "the board on radio still has its reference: another one was erased"


def test_the_loader_does_not_appear(due: Due, image: Path) -> None:
    due.ports = [listed(USB, PortKind.NATIVE)]
    around = due.around(touch=lambda port: due.ports.clear())
    error = broken(due, image, around, keep=False)
    assert "did not appear on USB within 10 s" in error.message
    assert 10.0 < due.now_s < 12.0


@pytest.mark.usefixtures("taught")
def test_ctrl_c_half_way(due: Due, image: Path) -> None:
    def interrupted(command: Sequence[str], timeout_s: float) -> ProgramResult:
        raise KeyboardInterrupt

    error = broken(due, image, due.around(run=interrupted))
    assert error.message == "stopped half way"
    assert "--restore" in error.remedy


def test_openocd_finds_no_probe(due: Due, image: Path) -> None:
    due.state(broken=["write"])
    error = broken(due, image, tool="openocd")
    why = "unable to find a matching CMSIS-DAP device"
    assert error.message == f"openocd could not write the image: {why}"
    assert error.remedy.startswith("Check the SWD probe")


@pytest.mark.usefixtures("taught")
def test_the_link_breaks_while_restoring(
    due: Due, image: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def cut(self: Fish, record: bytes) -> int:
        raise self.link.lost(6, 7.0)

    monkeypatch.setattr(Fish, "upload_reference", cut)
    error = broken(due, image)
    assert "but has not all of its content back (the board on sim:tank" in error.message
    assert error.remedy.startswith("What the board held goes back with: tailbeat board flash")


# The command


@pytest.fixture
def command(
    due: Due, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str, str]]:
    monkeypatch.setattr("tailbeat.board.flash.procedure.Surroundings", due.around)

    def call(*words: str) -> tuple[int, str, str]:
        status = run_command(["board", "flash", *words])
        return (status, *capsys.readouterr())

    return call


def test_quiet_when_all_is_well(due: Due, image: Path, command: Command) -> None:
    status, out, err = command(str(image))
    assert (status, err) == (0, "")
    (backup,) = Path("backups").iterdir()
    with Fish(SimTransport(due.board)) as fish:
        count = len(fish.params.list())
        build_id = fish.info().build_id
    assert out == (
        f"the board runs {build_id} and has back: {count} parameters; saved in {backup}\n"
    )


@pytest.mark.usefixtures("taught")
def test_json(image: Path, command: Command) -> None:
    status, out, err = command(str(image), "--port", ACM, "--json")
    assert (status, err) == (0, "")
    document = json.loads(out)
    assert set(document) == {
        "image", "size_bytes", "build_id", "tool", "port", "verified", "backup", "trials_pulled",
        "restored", "not_restored", "notes",
    }  # fmt: skip
    assert (document["tool"], document["port"], document["verified"]) == ("bossac", ACM, True)
    assert document["size_bytes"] == image.stat().st_size
    assert len(document["trials_pulled"]) == 2
    status, out, err = command("--restore", document["backup"], "--port", ACM, "--json")
    assert set(json.loads(out)) == {"backup", "restored", "not_restored", "notes"}


def test_an_empty_port_is_none(image: Path, command: Command) -> None:
    """As from `make flash` without PORT."""
    assert command(str(image), "--port", "")[0] == 0


@pytest.mark.usefixtures("taught")
def test_failure_is_one_line(due: Due, image: Path, command: Command) -> None:
    due.state(broken=["write"])
    status, out, err = command(str(image))
    assert (status, out) == (1, "")
    assert err.startswith("tailbeat: bossac could not write the image: the flash holds something")
    assert err.count("\n") == 1


@pytest.mark.usefixtures("taught")
def test_restore_onto_another_board(
    due: Due, taught: Content, image: Path, command: Command
) -> None:
    report = due.flash(image)
    assert report.backup is not None
    board = report.backup / "board.json"
    saved = Snapshot.read(report.backup)
    board.write_text(board.read_text().replace(saved.unique_id, "00" * 16))
    due.board.flash = b"\xff" * FLASH_BYTES
    status, out, err = command("--restore", str(report.backup), "--connect", ACM)
    assert (status, err) == (0, "")
    lines = out.splitlines()
    assert lines[0].startswith("the board has back: ")
    assert lines[-1] == f"note: the backup is of another board ({'00' * 16})"
    assert len(lines) == 2
    assert on_board(due).learned == taught.learned


def test_restore_needs_an_idle_board(
    due: Due, taught: Content, image: Path, command: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    backup = due.flash(image).backup
    monkeypatch.setattr(due.board.world, "power_cycle", lambda: None)
    with Fish(SimTransport(due.board)) as fish:
        fish.arm()
    status, _, err = command("--restore", str(backup), "--connect", "radio")
    assert status == 1
    assert "the board is ARMED and takes nothing back" in err
    assert on_board(due).params == taught.params


def test_a_parameter_the_new_firmware_refuses(due: Due, image: Path, command: Command) -> None:
    backup = due.flash(image).backup
    assert backup is not None
    board = backup / "board.json"
    document = json.loads(board.read_text())
    document["params"] |= {"ILC_GAIN": -1.0, "GONE": 2.0}
    board.write_text(json.dumps(document))
    _, out, _ = command("--restore", str(backup), "--port", ACM)
    refused = [line for line in out.splitlines() if line.startswith("not restored")]
    assert refused == [
        "not restored: ILC_GAIN = -1 (ILC_GAIN cannot be -1)",
        "not restored: GONE = 2 (this firmware has no such parameter)",
    ]
    assert out.startswith(f"the board has back: {len(document['params']) - 2} parameters\n")


def test_nothing_to_restore(command: Command, tmp_path: Path) -> None:
    status, _, err = command("--restore", str(tmp_path), "--connect", ACM)
    assert status == 1
    assert "is no backup of a board: cannot read" in err
    assert "it holds board.json" in err


def test_every_option_is_in_the_documentation(capsys: pytest.CaptureFixture[str]) -> None:
    run_command(["board", "flash", "--help"])
    page = capsys.readouterr().out
    options = {word.strip(",.") for word in page.split() if word.startswith("--")} - {"--help"}
    text = (Path(__file__).parents[3] / "docs" / "how-to" / "flash.md").read_text()
    assert {option for option in options if f"`{option}" not in text} == set()


def test_input_errors_are_input_errors(due: Due, tmp_path: Path) -> None:
    with pytest.raises(InputError):
        due.flash(tmp_path / "missing.bin")
