"""Words by which somebody at a second keyboard handles the simulated fish: lines like
``push -0.05``, answered with ``ok`` or with what is wrong."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from tailbeat.core.errors import InputError, TailbeatError
from tailbeat.sim.board import SimulatedBoard

OK = "ok"

_LINE_MAX_BYTES = 1000

_Act = Callable[[SimulatedBoard, Sequence[str]], str | None]


@dataclass(frozen=True)
class Word:
    """``use``: how it is written; what stands in brackets may be left out."""

    use: str
    does: str
    act: _Act

    @property
    def name(self) -> str:
        """What the line begins with."""
        return self.use.split()[0]


def _bad_use(use: str) -> InputError:
    return InputError(f"that is not how '{use.split()[0]}' is written", f"Write: {use}")


def _numbers(use: str, does: str, call: Callable[..., None]) -> Word:
    """A word with numbers behind it, which are handed to ``call`` after the board."""
    names = use.split()[1:]
    least = sum(not name.startswith("[") for name in names)

    def act(board: SimulatedBoard, said: Sequence[str]) -> None:
        try:
            values = [float(text) for text in said]
        except ValueError:
            raise _bad_use(use) from None
        if not least <= len(values) <= len(names):
            raise _bad_use(use)
        call(board, *values)

    return Word(use, does, act)


def _choice(use: str, does: str, calls: dict[str, Callable[[SimulatedBoard], None]]) -> Word:
    """A word with one of several words behind it."""

    def act(board: SimulatedBoard, said: Sequence[str]) -> None:
        if len(said) != 1 or said[0] not in calls:
            raise _bad_use(use)
        calls[said[0]](board)

    return Word(use, does, act)


def _set_swim(board: SimulatedBoard, number: float) -> None:
    if not 1 <= number < 1 << 32 or number != int(number):
        raise InputError(f"{number:g} is no number of a swim", "1 is the first.")
    board.set_swim(int(number))


def _truth(board: SimulatedBoard, said: Sequence[str]) -> str:
    if said:
        raise _bad_use("truth")
    return json.dumps(dataclasses.asdict(board.truth()))


def _config(board: SimulatedBoard, said: Sequence[str]) -> str:
    if said:
        raise _bad_use("config")
    return json.dumps({"plant": board.plant, "seed": board.seed, "simulator": board.config})


def _help(board: SimulatedBoard, said: Sequence[str]) -> str:
    del board, said
    width = max(len(word.use) for word in WORDS.values())
    return "\n".join(f"{word.use:<{width}}  {word.does}" for word in WORDS.values())


_ALL = (
    _numbers("push M_S", "a hand changes the fish's speed within 0.3 s", lambda b, v: b.push(v)),
    _numbers("hold S", "something stops the fish and lets it go after S", lambda b, s: b.hold(s)),
    _numbers("stir M_S", "the water moves along the tank, dying down", lambda b, v: b.stir(v)),
    _numbers(
        "place X_M Y_M HEADING_RAD",
        "somebody puts the fish there",
        lambda b, x, y, heading: b.place(x, y, heading),
    ),
    _numbers("start M_S", "speed at which the next swim starts", lambda b, v: b.set_start(v)),
    _numbers("tilt RAD", "rolls the fish", lambda b, roll: b.set_tilt_rad(roll)),
    _numbers("battery V", "the pack's voltage from now on", lambda b, v: b.set_battery_v(v)),
    _numbers(
        "swap V [GAIN] [CENTRE_RAD]",
        "another pack; thrust speed times GAIN, the tail's centre off by CENTRE_RAD more",
        lambda b, *values: b.swap_battery(*values),
    ),
    _choice(
        "camera on|off",
        "the camera",
        {"on": lambda b: b.set_camera(True), "off": lambda b: b.set_camera(False)},
    ),
    _choice(
        "radio on|off",
        "the radio link",
        {"on": lambda b: b.set_radio(True), "off": lambda b: b.set_radio(False)},
    ),
    _choice(
        "imu on|off|reboot|wedge",
        "its plug; wedged, it is silent until the next power-on",
        {
            "on": lambda b: b.set_imu(True),
            "off": lambda b: b.set_imu(False),
            "reboot": lambda b: b.reboot_imu(),
            "wedge": lambda b: b.wedge_imu(),
        },
    ),
    _choice("power cycle", "power off and on again", {"cycle": lambda b: b.power_cycle()}),
    _numbers("swim NUMBER", "the next swim's noise is that of swim NUMBER", _set_swim),
    Word("truth", "the fish's state as JSON", _truth),
    Word("config", "plant, seed and all values of the simulator as JSON", _config),
    Word("help", "these lines", _help),
)
WORDS = {word.name: word for word in _ALL}


def obey(board: SimulatedBoard, line: str) -> str:
    """Does what the line says and returns the answer: ``ok``, what was asked for, or what is wrong.
    Empty, and nothing done, for an empty line and one that begins with #."""
    said = line.split()
    if not said or said[0].startswith("#"):
        return ""
    try:
        word = WORDS.get(said[0])
        if word is None:
            names = ", ".join(WORDS)
            raise InputError(f"there is no word '{said[0][:20]}'", f"There are: {names}.")
        return word.act(board, said[1:]) or OK
    except TailbeatError as error:
        return " ".join(str(error).split())


class Lines:
    """Puts lines together out of what a client sends."""

    def __init__(self, board: SimulatedBoard) -> None:
        self._board = board
        self._rest = b""

    def hear(self, data: bytes, last: bool = False) -> bytes:
        """The answers to the lines that ``data`` ends; ``last``: nothing will follow."""
        *whole, self._rest = (self._rest + data).split(b"\n")
        if last or len(self._rest) > _LINE_MAX_BYTES:
            whole.append(self._rest)
            self._rest = b""
        answers = (obey(self._board, line.decode("utf-8", "replace")) for line in whole)
        return "".join(f"{answer}\n" for answer in answers if answer).encode()
