"""tailbeat board bluetooth, against models of the modules."""

from __future__ import annotations

import json
import os
import random
import select
import sys
from collections.abc import Iterator

import pytest

from tailbeat.app.cli import run
from tailbeat.board import bluetooth
from tailbeat.board.bluetooth import ModuleSettings, SetupReport, setup
from tailbeat.core.errors import ConnectError, InputError, TailbeatError
from tailbeat.link.serial import SerialTransport

from ..radio_model import FakeLine, Hc06, Module, heartbeat

needs_pty = pytest.mark.skipif(sys.platform == "win32", reason="no ptys")


def changed_by(module: Module, **wanted: str) -> SetupReport:
    return setup(FakeLine(module), **wanted)


@pytest.mark.parametrize("firmware", [2, 3, 4])
@pytest.mark.parametrize("at_baud", [38400, 9600, 115200])
def test_a_factory_module(firmware: int, at_baud: int) -> None:
    module = Module(firmware, at_baud)
    report = changed_by(module, name="fish", pin="4711")
    assert (report.module, report.at_baud) == ("HC-05", at_baud)
    assert report.firmware in ("2.0-20100601", "3.0-20170601", "x")
    assert report.found.baud == 9600
    assert report.changed == ["baud", "name", "pin"]
    assert (module.uart, module.name, module.pin) == ("115200,0,0", "fish", "4711")
    assert report.now == ModuleSettings(115200, 0, 0, "fish", "4711")
    assert module.resets == 1


def test_only_the_speed_unless_asked() -> None:
    module = Module()
    assert changed_by(module).changed == ["baud"]
    assert (module.uart, module.name, module.pin) == ("115200,0,0", "HC-05", "1234")


@pytest.mark.parametrize("firmware", [2, 3])
def test_what_is_as_wanted_is_left_alone(firmware: int) -> None:
    module = Module(firmware, uart="115200,0,0", name="fish", pin="4711")
    report = changed_by(module, name="fish", pin="4711")
    assert report.changed == []
    assert not [command for command in module.said if "=" in command or "RESET" in command]


@pytest.mark.parametrize("uart", ["115200,1,0", "115200,0,2", "57600,0,0"])
def test_stop_bits_and_parity_count_too(uart: str) -> None:
    module = Module(uart=uart)
    assert changed_by(module).changed == ["baud"]
    assert module.uart == "115200,0,0"


def test_quotes_go_only_where_they_are_wanted() -> None:
    old, new = Module(2), Module(3)
    for module in (old, new):
        changed_by(module, pin="4711")
        assert module.pin == "4711"
    assert 'AT+PSWD="4711"' not in old.said
    assert 'AT+PSWD="4711"' in new.said


def test_an_echo_is_no_answer() -> None:
    module = Module(echo=True)
    assert changed_by(module, name="fish").changed == ["baud", "name"]
    assert module.name == "fish"


def test_slow_answers() -> None:
    module = Module(delay_s=0.6)
    assert changed_by(module, pin="4711").changed == ["baud", "pin"]


def test_what_a_module_refuses_is_said_in_words() -> None:
    with pytest.raises(TailbeatError, match=r"ERROR:\(11\) \(it does not have this baud rate\)"):
        changed_by(Module(refuse={"AT+UART=": "ERROR:(11)"}))
    with pytest.raises(
        TailbeatError, match=r"refuses the name.*ERROR:\(3\) \(the name is too long"
    ):
        changed_by(Module(refuse={"AT+NAME=": "ERROR:(3)"}), name="fish")
    with pytest.raises(TailbeatError, match=r"refuses even AT: FAIL"):
        changed_by(Module(refuse={"AT": "FAIL"}))
    with pytest.raises(TailbeatError, match=r"ERROR:\(77\)$"):
        raise TailbeatError(str(bluetooth._error("ERROR:(77)")))


def test_what_a_module_took_but_did_not_keep_is_noticed() -> None:
    with pytest.raises(TailbeatError, match="did not keep it: it says 9600"):
        changed_by(Module(refuse={"AT+UART=": "OK"}))
    with pytest.raises(TailbeatError, match="did not keep it: it says 1234"):
        changed_by(Module(refuse={"AT+PSWD=": "OK"}), pin="4711")


def test_an_hc06() -> None:
    module = Hc06()
    report = changed_by(module, name="fish", pin="4711")
    assert (report.module, report.firmware, report.at_baud) == ("HC-06", "linvorV1.8", 9600)
    assert report.changed == ["baud", "name", "pin"]
    assert (module.at_baud, module.name, module.pin) == (115200, "fish", "4711")
    assert changed_by(module).changed == []
    assert module.said.count("AT+BAUD8") == 1


def test_an_hc06_that_does_not_change() -> None:
    class Stubborn(Hc06):
        def hear(self, data: bytes, baud: int) -> bytes:
            return b"OK115200" if data == b"AT+BAUD8" else super().hear(data, baud)

    with pytest.raises(TailbeatError, match="did not keep it"):
        changed_by(Stubborn())


def told(line: FakeLine) -> str:
    with pytest.raises(ConnectError) as error:
        setup(line)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_nothing_answers() -> None:
    text = told(FakeLine(None))
    assert "nothing answers to AT on /dev/ttyUSB0 at 38400, 9600 and 115200 baud" in text
    assert "hold its KEY (EN, or the button) high, power on" in text


def test_a_module_in_data_mode() -> None:
    text = told(FakeLine(None, noise=b"\x8a\x03\x51"))
    assert "the module is in data mode, and connected" in text
    assert "KEY" in text


def test_a_board_instead_of_a_module() -> None:
    said = heartbeat(random.Random(1), 7, signed=False)
    assert "is a board, not a Bluetooth module" in told(FakeLine(None, noise=said))


def test_a_board_that_says_much() -> None:
    """More came at other speeds than is kept."""
    draw = random.Random(1)
    said = b"".join(heartbeat(draw, number, signed=False) for number in range(400))
    assert "is a board, not a Bluetooth module" in told(FakeLine(None, noise=said))


def test_an_adapter_that_hears_itself() -> None:
    assert "comes back" in told(FakeLine(None, loop=True))


@pytest.mark.parametrize("wanted", [{"name": "a,b"}, {"name": ""}, {"name": "x" * 21},
                                    {"pin": "12"}, {"pin": "abcd"}])  # fmt: skip
def test_wishes_that_make_no_sense(wanted: dict[str, str]) -> None:
    module = Module()
    with pytest.raises(InputError):
        changed_by(module, **wanted)
    assert module.said == []


# The command, on a pseudo terminal


class PtyModule(Module):
    """A module behind a pseudo terminal; it looks at the speed the port is set to. It is served in
    the waits of who talks to it, and only those take (virtual) time."""

    def __init__(self) -> None:
        super().__init__(2)
        self.master, self.slave = os.openpty()
        self.now_s = 0.0
        self.due = 0

    def wrote(self, data: bytes) -> None:
        self.due += len(data)

    def wait(self, timeout_s: float) -> None:
        import termios

        self.now_s += timeout_s
        if not self.due:
            return
        speeds = {getattr(termios, f"B{baud}"): baud for baud in (9600, 38400, 57600, 115200)}
        data = self._come()
        out = self.hear(data, speeds[termios.tcgetattr(self.master)[5]])
        if out:
            os.write(self.master, out)
            self.answered(len(out))

    def _come(self) -> bytes:
        data = b""
        while len(data) < self.due:
            data += os.read(self.master, self.due - len(data))
        self.due = 0
        return data

    def answered(self, count: int) -> None:
        """Until so many bytes have come through the terminal."""
        import fcntl
        import termios

        waiting = 0
        while waiting < count:
            assert select.select([self.slave], [], [], 60.0)[0]
            packed = fcntl.ioctl(self.slave, termios.FIONREAD, bytes(4))
            waiting = int.from_bytes(packed, sys.byteorder)

    def close(self) -> None:
        os.close(self.slave)
        os.close(self.master)


@pytest.fixture
def pty_module(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[str, Module]]:
    import tty

    module = PtyModule()
    tty.setraw(module.slave)
    write = SerialTransport.write

    def sent(line: SerialTransport, data: bytes) -> None:
        write(line, data)
        module.wrote(data)

    monkeypatch.setattr(SerialTransport, "write", sent)
    monkeypatch.setattr(SerialTransport, "wait", lambda _, timeout_s: module.wait(timeout_s))
    monkeypatch.setattr(SerialTransport, "now_s", lambda _: module.now_s)
    yield os.ttyname(module.slave), module
    module.close()


@needs_pty
def test_the_command(pty_module: tuple[str, Module], capsys: pytest.CaptureFixture[str]) -> None:
    path, module = pty_module
    module.at_baud = 9600
    assert run(["board", "bluetooth", path, "--name", "fish"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert out == (
        "HC-05, firmware 2.0-20100601, answered AT at 9600 baud: 9600 baud raised to 115200, name"
        " fish. Power it off, release KEY, put it back into the fish, and pair it anew.\n"
    )
    assert (module.uart, module.name) == ("115200,0,0", "fish")
    module.at_baud = 38400
    assert run(["board", "bluetooth", path, "--name", "fish", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["changed"] == []
    assert document["now"]["baud"] == 115200
    assert run(["board", "bluetooth", path]) == 0
    assert "already at 115200 baud, nothing changed" in capsys.readouterr().out
    assert run(["board", "bluetooth", path, "--pin", "x"]) == 1
    assert "is no PIN" in capsys.readouterr().err
