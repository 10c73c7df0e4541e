"""The table of the commands, and of their old names; runs one and prints its errors."""

from __future__ import annotations

import contextlib
import os
import re
import sys
from collections.abc import Iterator
from typing import Any

import typer

from tailbeat.app.cli._lazy import Entry, LazyCommand, LazyGroup, opt
from tailbeat.app.cli._terminal import echo, json_asked, json_line, typed_words, warn
from tailbeat.core.errors import TailbeatError, did_you_mean, reason

_OS_REMEDY = "Check the path, your rights there and the free space."

CONNECT, RUN, ANALYSE = "Connect", "Run", "Analyse"
SET_UP, REFERENCE, SIMULATE = "Set up", "Reference", "Simulate"

_LOGBOOK = ("--logbook", "--library")
_NEGATIVE_VALUES = {"ignore_unknown_options": True}

GROUPS = {
    "board": Entry("Check, arm and stop the board; its firmware, key and Bluetooth", CONNECT),
    "board key": Entry("The key that a board accepts commands with, and who has it", was="key"),
    "board imu": Entry("The IMU: its state, its settings, raw frames", default="status", was="imu"),
    "session": Entry("A session at the tank: commission, trim, identify, resume", RUN),
    "trial": Entry("Run a trial; list, pull and show the logs", RUN),
    "experiment": Entry("The folder of a series: notes, progress, compare, export", ANALYSE),
    "params": Entry("The board's parameters", SET_UP),
    "camera": Entry("Speed from an overhead camera", SET_UP),
    "reference": Entry("The desired speed per tail beat", REFERENCE),
    "sim": Entry("A simulated fish, the demo, the studies", SIMULATE, default="fish"),
}

COMMANDS = {
    "info": Entry("Print what is connected and its state", CONNECT, module="info"),
    "board check": Entry("Check everything from the port to the battery", was="doctor"),
    "board arm": Entry("Get ready for a trial; the tail stays off", was="arm"),
    "board disarm": Entry("Back to idle; a running trial is aborted", was="disarm"),
    "board clear": Entry("Leave a stop, after an abort or a fault", was="clear"),
    "board watch": Entry("Print the board's messages as JSON lines", was="watch"),
    "board crash": Entry("Print how the firmware last crashed", was="crash"),
    "board flash": Entry("Write new firmware; the board's data is restored", was="flash"),
    "board bluetooth": Entry("Bring an HC-05 or HC-06 to 115200 baud", was="bluetooth setup"),
    "board key set": Entry("Give the board a new key"),
    "board key status": Entry("Print which key the board and this computer have"),
    "board key list": Entry("Print the keys on this computer"),
    "board key erase": Entry("Delete the key on the board and on this computer"),
    "board key export": Entry("Write a key into a file, for another computer"),
    "board key import": Entry("Read a key from another computer"),
    "board key delete": Entry("Delete a key on this computer", was="key forget"),
    "board imu status": Entry("Print the IMU's state, and what to do"),
    "board imu save": Entry("Write the IMU's settings into its own flash"),
    "board imu calibrate": Entry(
        "Calibrate it by turning the fish by hand", module="imu_calibration"
    ),
    "board imu record": Entry("Write the IMU's raw frames to a CSV file"),
    "board imu decode": Entry("Decode a VN-100's recording, or listen to one", was="vn100"),
    "start": Entry("Lead from a connected fish to a report, step by step", RUN, module="start"),
    "session commission": Entry(
        "Check, trim and measure a new fish, design its law", SET_UP, was="session first"
    ),
    "session trim": Entry("Find the servo's centre in two short trials", SET_UP, was="trim"),
    "session identify": Entry(
        "Measure the fish: drag, speed over amplitude, delay",
        SET_UP,
        module="identify",
        was="identify",
        renamed=_LOGBOOK,
    ),
    "session design": Entry(
        "Choose gain, lead and filter for an identified fish", SET_UP, was="design"
    ),
    "session status": Entry("Print the experiment, best trial and limits", RUN),
    "session resume": Entry("Restore the board after a battery swap", RUN),
    "session web": Entry(
        "Run the session on a web page",
        RUN,
        module="web",
        was="ui",
        needs=("nicegui", "web", "The page needs NiceGUI"),
    ),
    "trial run": Entry("Run the next trial", module="trial_run"),
    "trial list": Entry("Print the trials whose logs are on the board", module="stop"),
    "trial pull": Entry("Copy logs from the board"),
    "trial show": Entry("Print a trial"),
    "trial speeds": Entry("Upload speeds measured after the trial", was="speed upload"),
    "trial learn": Entry("Let the board learn from the pending trial", module="learn", was="learn"),
    "trial discard": Entry("Drop the pending trial without learning"),
    "stop": Entry("Stop the tail now", RUN, module="stop", was="trial abort"),
    "experiment new": Entry("Make the folder of a new series"),
    "experiment use": Entry("Continue an experiment"),
    "experiment set": Entry("Set conditions that became known later"),
    "experiment note": Entry("Add a line to the notes"),
    "experiment list": Entry("Print the experiments below a folder"),
    "experiment show": Entry("Print conditions, trials and notes"),
    "experiment progress": Entry(
        "Assess the convergence: go on or stop", module="report", was="progress", renamed=_LOGBOOK
    ),
    "experiment compare": Entry("Compare two experiments"),
    "experiment replay": Entry("Compute everything again, compare the bits"),
    "experiment export": Entry("Write CSV, MATLAB, Parquet, MCAP or ULog"),
    "report": Entry("Write a page, figures and tables of an experiment", ANALYSE, module="report"),
    "params get": Entry("Print one parameter"),
    "params set": Entry("Change one parameter", settings=_NEGATIVE_VALUES),
    "params list": Entry("Print all parameters"),
    "params preset": Entry("Set all parameters of a named set"),
    "params save": Entry("Keep the present values through a power cycle"),
    "params load": Entry("Bring the saved values back"),
    "params reset": Entry("Set every parameter to its default"),
    "camera print": Entry("Write a sheet to print: markers, ruler"),
    "camera calibrate": Entry("Calibrate a camera over a tank"),
    "camera track": Entry("Find the fish in a film, and its speed"),
    "camera render": Entry("Film a simulated trial"),
    "reference upload": Entry(
        "Check a reference and make it the board's", renamed=("--like", "--warm-start")
    ),
    "reference show": Entry("Print the board's reference"),
    "reference check": Entry("Check a reference against board, tank and fish"),
    "sim fish": Entry("Serve a simulated fish"),
    "sim board": Entry("Serve the flash image on an emulated board", was="vboard"),
    "sim demo": Entry("Show a simulated fish that learns, with a report", was="demo"),
    "sim montecarlo": Entry("Run a study with many simulated fish", module="studies", was="sweep"),
    "sim thesis": Entry(
        "Recompute the thesis's examples and claims", module="studies", was="thesis"
    ),
    "sim law": Entry("Apply the learning law once", was="law"),
    "sim selftest": Entry("Run the firmware's unit tests on this computer", was="selftest"),
}

_OLD_NAMES = Entry("Old names")
_OLD_GROUPS = {entry.was: entry for entry in GROUPS.values() if entry.was}


def aliases() -> Iterator[tuple[str, str]]:
    """(old path, new path) of each command that has an old name."""
    for new, entry in (GROUPS | COMMANDS).items():
        for path in COMMANDS:
            if entry.was and f"{path} ".startswith(f"{new} "):
                yield entry.was + path.removeprefix(new), path


class Root(LazyGroup):
    """All commands; hidden ones under their old names."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        for typed, path in (*((path, path) for path in COMMANDS), *aliases()):
            self._add(typed, path)

    def _add(self, typed: str, path: str) -> None:
        """The command of the table's ``path``, under the words ``typed``."""
        hidden = typed != path
        *above, name = typed.split()
        here: Any = self
        for depth, word in enumerate(above, start=1):
            if word not in here.commands:
                entry = (GROUPS | _OLD_GROUPS).get(" ".join(above[:depth]), _OLD_NAMES)
                here.add_command(LazyGroup.of(word, entry, hidden))
            here = here.commands[word]
        if name not in here.commands:
            here.add_command(LazyCommand(name, path, COMMANDS[path], hidden))


app = typer.Typer(
    cls=Root,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="A robotic fish learns to track a speed profile.\n\n"
    "First steps: 'tailbeat sim demo' shows it in simulation. 'tailbeat sim' serves a simulated "
    "fish. 'tailbeat start' leads through a whole session with any fish.",
)


def _version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version  # 15 ms, which no other command needs

        echo(f"tailbeat {version('tailbeat')}")
        raise typer.Exit


@app.callback()
def _root(
    version: bool = opt(
        "Print the version.", name="--version", default=False, callback=_version, is_eager=True
    ),
) -> None:
    del version


_NO_COMMAND = "NoArgsIsHelpError"  # of the library that reads the words, which does not export it
_BEFORE = {"--connect": 2, "--json": 1}  # accepted before the command, too; so many words each


def _ordered(words: list[str]) -> list[str]:
    """With options that were typed before or within the command's name behind it; without a
    command they mean nothing and go."""
    named: list[str] = []
    moved: list[str] = []
    while words:
        if count := _BEFORE.get(words[0].partition("=")[0]):
            count = 1 if "=" in words[0] else count
            moved, words = [*moved, *words[:count]], words[count:]
        elif _begins_a_command([*named, words[0]]):
            named, words = [*named, words[0]], words[1:]
        else:
            break
    return [*named, *moved, *words] if named else words


def _begins_a_command(words: list[str]) -> bool:
    """Whether these are the first words, or all, of a command's name, an old one included."""
    beginning = " ".join(words) + " "
    return any(f"{typed} ".startswith(beginning) for typed in (*COMMANDS, *dict(aliases())))


def run_command(words: list[str]) -> int:
    """Runs it; every error of every command is printed here."""
    words = _ordered(words)
    typed_words.set(tuple(words))
    json_asked.set("--json" in words)  # until the options are known
    try:
        result = app(words, prog_name="tailbeat", standalone_mode=False)
        sys.stdout.flush()  # here a full disk can still be reported
    except TailbeatError as error:
        return _failed(error)
    except typer.TyperException as error:
        if type(error).__name__ == _NO_COMMAND and not json_asked.get():
            echo(error.format_message())  # the help, as it is written
            return error.exit_code
        return _failed(_usage_error(error), error.exit_code)
    except (typer.Abort, KeyboardInterrupt):
        return 130
    except BrokenPipeError:
        _discard_stdout()  # the reader has gone
        return 1
    except OSError as error:
        where = error.filename if error.filename is not None else "the output"
        status = _failed(TailbeatError(f"cannot use {where} ({reason(error)})", _OS_REMEDY))
        _discard_stdout()
        return status
    return result if isinstance(result, int) else 0


def _failed(error: TailbeatError, status: int = 1) -> int:
    warn(str(error))
    if json_asked.get():
        words = {"message": error.message, "remedy": error.remedy}
        with contextlib.suppress(OSError):  # the output may be what has failed
            json_line({**error.document, "error": words})
    return status


def _usage_error(error: Any) -> TailbeatError:
    message = getattr(error, "format_message", lambda: error)()
    command = getattr(getattr(error, "ctx", None), "command_path", "tailbeat")
    message = str(message).replace("Value error, ", "")  # of a list of words; says nothing
    return TailbeatError(message, f"{_meant(message, error)}Try: {command} --help")


_NO_CHOICE = re.compile(r"'([^']*)' is not one of ((?:'[^']*'(?:, )?)+)")


def _meant(message: str, error: Any) -> str:
    """What the library that reads the words does not say by itself: a choice, and an option before
    the command."""
    if found := _NO_CHOICE.search(message):
        return did_you_mean(found[1], re.findall(r"'([^']*)'", found[2]))
    if (option := getattr(error, "option_name", None)) and not error.possibilities:
        return did_you_mean(option, [name for name in _BEFORE if name != option])
    return ""


def _discard_stdout() -> None:
    """What could not be written is not tried again, and failed again, at exit."""
    with contextlib.suppress(OSError, ValueError):
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, sys.stdout.fileno())
        os.close(null)
