"""What differs between systems: each asked for all three on this one, modules that it lacks played.
The terminal of this system is a real one."""

from __future__ import annotations

import ast
import contextlib
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import tailbeat
from tailbeat.core.platform import files as platform_files
from tailbeat.core.platform import ports, programs
from tailbeat.core.platform.terminal import Keys, TerminalGone, terminal_keys

SYSTEMS = ("linux", "darwin", "win32")
posix = pytest.mark.skipif(sys.platform == "win32", reason="a POSIX terminal")
MODULES = {"msvcrt", "termios", "tty", "pty", "fcntl", "winreg", "resource", "platform"}
NAMES = {
    "os": {"name", "uname", "ttyname", "openpty", "set_blocking", "sched_getaffinity", "O_BINARY"},
    "signal": {"SIGHUP"},
    "sys": {"platform", "getwindowsversion"},
}


def asks_for_the_system(node: ast.AST) -> bool:
    """``sys.platform``, ``os.name``, ``hasattr(os, ...)``, what not every system has."""
    match node:
        case ast.Attribute(ast.Name(module), name):
            return name in NAMES.get(module, ())
        case ast.Import(found):
            return any(one.name in MODULES or (one.name in NAMES and one.asname) for one in found)
        case ast.ImportFrom(module, found):
            return module in MODULES or any(one.name in NAMES.get(module, ()) for one in found)
        case ast.Call(ast.Name("hasattr" | "getattr"), [ast.Name(module), *_]):
            return module in NAMES
        case ast.Call(ast.Attribute(attr=name) | ast.Name(name), [ast.Constant(module), *_]):
            return name in ("import_module", "__import__") and module in MODULES
    return False


@pytest.mark.parametrize(
    "line",
    [
        "sys.platform",
        "from sys import argv, platform",
        "import os as system",
        "from os import name",
        "hasattr(os, 'fork')",
        "getattr(sys, 'platform')",
        "os.ttyname(0)",
        "import json, termios",
        "from fcntl import flock",
        "importlib.import_module('msvcrt')",
        "import_module('pty')",
    ],
)
def test_what_asks_for_the_system(line: str) -> None:
    assert any(map(asks_for_the_system, ast.walk(ast.parse(line))))


def test_nothing_else_asks_which_system_it_is() -> None:
    root = Path(tailbeat.__file__).parent
    asking = {
        path.relative_to(root)
        for path in root.rglob("*.py")
        if any(map(asks_for_the_system, ast.walk(ast.parse(path.read_text()))))
    }
    assert asking and {path.parent for path in asking} == {Path("core/platform")}


@pytest.mark.parametrize(
    ("system", "library", "program", "install"),
    [
        ("linux", "liba.so", "a", "apt-get install bossa-cli"),
        ("darwin", "liba.dylib", "a", "brew install bossa-cli"),
        ("win32", "liba.dll", "a.exe", "put its folder into PATH"),
    ],
)
def test_names_and_words(system: str, library: str, program: str, install: str) -> None:
    assert programs.library_name("a", system) == library
    assert programs.program_name("a", system) == program
    assert install in programs.install_program("bossa-cli", system)


def test_names_of_ports(tmp_path: Path) -> None:
    port, link = tmp_path / "tty", tmp_path / "fish"
    port.touch()
    link.symlink_to(port)
    for system in ("linux", "darwin"):
        assert ports.same_port(str(port), str(link), system)
        assert not ports.same_port(str(port), str(port).upper(), system)
        assert ports.is_unlisted_port(str(link), system)
        assert ports.is_serial_port("/dev/null", system), "a character device"
        assert not ports.is_serial_port(str(port), system), "a file"
    assert ports.same_port("COM3", "com3", "win32") and not ports.same_port("COM3", "COM4", "win32")
    assert not ports.is_unlisted_port(str(port), "win32")
    assert ports.is_serial_port("com3", "win32") and ports.is_serial_port(r"\\.\COM12", "win32")
    assert not ports.is_serial_port("imu.bin", "win32")


def test_who_may_use_a_port(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "hold it" in ports.port_permission_remedy("COM3", "win32")
    assert "group dialout" in ports.port_permission_remedy(str(tmp_path / "none"), "linux")
    monkeypatch.setattr(Path, "group", lambda _: "uucp")
    assert "usermod -aG uucp $USER" in ports.port_permission_remedy("/dev/ttyS0", "linux")


def test_cameras_are_files_on_linux_only() -> None:
    assert ports.camera_node("0", "linux") == Path("/dev/video0")
    assert ports.camera_node("/dev/v4l/x", "linux") == Path("/dev/v4l/x")
    assert ports.camera_node("0", "darwin") is ports.camera_node("0", "win32") is None


class PolledPort:
    """A port of Windows: it has bytes after some looks."""

    def __init__(self, looks: int) -> None:
        self.looks = looks

    @property
    def in_waiting(self) -> int:
        self.looks -= 1
        return int(self.looks < 0)


def test_windows_asks_a_port_for_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SimpleNamespace(now_s=0.0)
    monkeypatch.setattr(ports.time, "monotonic", lambda: clock.now_s)
    monkeypatch.setattr(ports.time, "sleep", lambda s: setattr(clock, "now_s", clock.now_s + s))
    ports.wait_for_bytes(PolledPort(looks=3), 1.0, "win32")
    assert clock.now_s == pytest.approx(0.006)
    ports.wait_for_bytes(PolledPort(looks=10**6), 0.5, "win32")
    assert clock.now_s == pytest.approx(0.506)


def test_posix_waits_for_a_port() -> None:
    reading, writing = os.pipe()
    with os.fdopen(reading, "rb") as end, os.fdopen(writing, "wb", buffering=0) as other:
        ports.wait_for_bytes(end, 0.0, "linux")
        other.write(b"x")
        ports.wait_for_bytes(end, 60.0, "linux")


def test_a_system_without_ptys(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pty", None)
    assert ports.open_pty() is None


@posix
def test_a_pty() -> None:
    ends = ports.open_pty()
    assert ends is not None
    near, far, path = ends
    try:
        assert not os.get_blocking(near)
        Path(path).write_bytes(b"raw\n")
        assert os.read(near, 9) == b"raw\n", "no carriage return is put in"
    finally:
        os.close(near)
        os.close(far)


def test_windows_of_a_browser() -> None:
    assert programs.has_windows("darwin", {}) and programs.has_windows("win32", {})
    assert not programs.has_windows("linux", {})
    assert programs.has_windows("linux", {"DISPLAY": ":0"})
    assert programs.has_windows("linux", {"WAYLAND_DISPLAY": "wayland-0"})


def test_cores_and_signals(monkeypatch: pytest.MonkeyPatch) -> None:
    assert programs.cores_here() >= 1
    monkeypatch.delattr(programs.os, "sched_getaffinity", raising=False)
    monkeypatch.setattr(programs.os, "cpu_count", lambda: 7)
    assert programs.cores_here() == 7
    monkeypatch.delattr(signal, "SIGHUP", raising=False)
    assert programs.terminal_closed() == []
    limits = SimpleNamespace(RLIMIT_NOFILE=7, RLIM_INFINITY=-1, getrlimit=lambda _: (400, 1000))
    monkeypatch.setitem(sys.modules, "resource", limits)
    assert programs.open_files_max() == 400
    limits.getrlimit = lambda _: (-1, -1)
    assert programs.open_files_max() is None
    monkeypatch.setitem(sys.modules, "resource", None)
    assert programs.open_files_max() is None


@pytest.mark.parametrize("system", SYSTEMS)
def test_lasting_names_and_permissions(tmp_path: Path, system: str) -> None:
    file = tmp_path / "key"
    file.touch()
    file.chmod(0o644)
    posix = system != "win32"
    platform_files.sync_folder(tmp_path, system)
    if posix:
        with pytest.raises(FileNotFoundError):
            platform_files.sync_folder(tmp_path / "none", system)
    else:
        platform_files.sync_folder(tmp_path / "none", system)
    assert platform_files.readable_by_others(file, system) == posix
    file.chmod(0o600)
    assert not platform_files.readable_by_others(file, system)
    assert platform_files.renames_open_files(system) == posix


class Locking:
    """Locks of ranges of bytes as Windows has them: of one holder at a time."""

    LK_NBLCK = 2

    def __init__(self) -> None:
        self.held: list[tuple[int, int]] = []

    def locking(self, descriptor: int, mode: int, count: int) -> None:
        assert mode == self.LK_NBLCK and count == 1
        at = os.lseek(descriptor, 0, os.SEEK_CUR)
        if self.held:
            raise PermissionError(13, "Permission denied")
        self.held.append((descriptor, at))


@pytest.mark.parametrize("system", SYSTEMS)
def test_locks(tmp_path: Path, system: str, monkeypatch: pytest.MonkeyPatch) -> None:
    windows = Locking()
    monkeypatch.setitem(sys.modules, "msvcrt", windows)
    path = tmp_path / "lock"
    path.write_bytes(b"held by others")
    with path.open("rb+") as first, path.open("rb+") as second:
        assert platform_files.try_lock(first.fileno(), system)
        assert not platform_files.try_lock(second.fileno(), system)
    if system == "win32":
        ((_, at),) = windows.held
        assert at > path.stat().st_size, "others may still read the file"


class Console:
    """The keys of a console of Windows, typed beforehand."""

    def __init__(self, typed: str) -> None:
        self.typed = list(typed)

    def kbhit(self) -> bool:
        return bool(self.typed)

    def getwch(self) -> str:
        return self.typed.pop(0)


def windows_keys(monkeypatch: pytest.MonkeyPatch, typed: str) -> Any:
    monkeypatch.setitem(sys.modules, "msvcrt", Console(typed))
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(isatty=lambda: True))
    return terminal_keys("win32")


def test_keys_of_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    with windows_keys(monkeypatch, "\xe0HK\x03xyz") as keys:
        assert keys.pressed()
        assert keys.key(0.0) is None, "an arrow, not an H"
        assert keys.key(0.0) == "k"
        with pytest.raises(KeyboardInterrupt):
            keys.key(0.0)
        keys.forget()
        assert not keys.pressed() and keys.key(0.0) is None
        monkeypatch.setattr("builtins.input", lambda: "bumped the wall")
        assert keys.line() == "bumped the wall"


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[int, int]]:
    """(where one types, the program's end)"""
    hand, program = os.openpty()
    with os.fdopen(program, closefd=False) as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        yield hand, program
    for descriptor in (hand, program):
        with contextlib.suppress(OSError):
            os.close(descriptor)


def modes(descriptor: int) -> list[Any]:
    import termios

    return termios.tcgetattr(descriptor)


@posix
def test_single_keys(terminal: tuple[int, int]) -> None:
    import termios

    hand, program = terminal
    usual = modes(program)
    with terminal_keys() as keys:
        assert keys is not None and not keys.pressed()
        assert not modes(program)[3] & (termios.ICANON | termios.ECHO)
        assert modes(program)[3] & termios.ISIG, "Ctrl-C stays what it is"
        assert keys.key(0.0) is None
        os.write(hand, b" ")
        assert keys.key(5.0) == " "
        os.write(hand, b"xyz")
        while not keys.pressed():
            pass
        assert keys.pressed(), "until it is asked for, or forgotten"
        keys.forget()
        assert not keys.pressed()
    assert modes(program) == usual


@posix
def test_an_arrow_is_no_escape(terminal: tuple[int, int]) -> None:
    hand, _ = terminal
    with terminal_keys() as keys:
        assert keys is not None
        os.write(hand, b"\x1b[A")
        assert keys.key(5.0) is None
        os.write(hand, b"\x1b")
        assert keys.key(5.0) == "\x1b"


@posix
@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_the_terminal_is_put_back_whatever_happens(
    terminal: tuple[int, int], error: type[BaseException]
) -> None:
    usual = modes(terminal[1])
    with pytest.raises(error), terminal_keys():
        raise error
    assert modes(terminal[1]) == usual


@posix
def test_a_typed_reason(terminal: tuple[int, int], monkeypatch: pytest.MonkeyPatch) -> None:
    hand, program = terminal
    with terminal_keys() as keys:
        single = modes(program)
        assert keys is not None
        type_when_asked(keys, hand, monkeypatch)
        assert keys.line() == "bumped the wall"
        assert modes(program) == single


def type_when_asked(keys: Keys, hand: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Types once the terminal is back in lines: what came before is forgotten."""
    real = os.read

    def read(descriptor: int, count: int) -> bytes:
        os.write(hand, b"bumped the wall\n")
        return real(descriptor, count)

    monkeypatch.setattr("tailbeat.core.platform.terminal.os.read", read)


@posix
def test_a_terminal_that_is_gone(terminal: tuple[int, int]) -> None:
    hand, _ = terminal
    with terminal_keys() as keys:
        assert keys is not None
        os.close(hand)
        assert keys.pressed(), "nobody can stop the tail any more, so it stops"
        with pytest.raises(TerminalGone):
            keys.key(1.0)


def test_no_terminal_no_keys() -> None:
    with terminal_keys() as keys:
        assert keys is None
