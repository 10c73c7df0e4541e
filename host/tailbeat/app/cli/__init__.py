"""The command line: ``tailbeat``. A thin skin over the library.

Only what Python has loaded already is imported here: Ctrl-C is caught from ``main`` on.
"""

from __future__ import annotations

import os
import sys

_INTERRUPTED = 130
_OS_REMEDY = "Check the path, your rights there and the free space."


def main() -> None:
    """Entry point. Exit status: 0 done, 1 refused or failed, 2 wrongly called, 130 Ctrl-C."""
    try:
        status = run()
    except KeyboardInterrupt:  # before the first command was known
        status = _INTERRUPTED
    sys.exit(status)


def run(arguments: list[str] | None = None) -> int:
    """Runs one command and returns its exit status; errors are one line on stderr."""
    import typer

    from tailbeat.app.cli._lazy import typed_words
    from tailbeat.app.cli.app import app
    from tailbeat.core.errors import TailbeatError, reason

    typed_words.set(tuple(sys.argv[1:] if arguments is None else arguments))
    try:
        result = app(arguments, prog_name="tailbeat", standalone_mode=False)
        sys.stdout.flush()  # here a full disk can still be told
    except TailbeatError as error:
        return _fail(str(error), 1)
    except typer.TyperException as error:
        return _fail(_usage(error), error.exit_code)
    except (typer.Abort, KeyboardInterrupt):
        return _INTERRUPTED
    except BrokenPipeError:
        _discard_stdout()  # the reader has gone
        return 1
    except OSError as error:
        _discard_stdout()
        where = error.filename if error.filename is not None else "the output"
        return _fail(f"cannot use {where} ({reason(error)}). {_OS_REMEDY}", 1)
    return result if isinstance(result, int) else 0


def _discard_stdout() -> None:
    """What could not be written is not tried again, and failed again, at exit."""
    import contextlib

    with contextlib.suppress(OSError, ValueError):
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, sys.stdout.fileno())
        os.close(null)


def _usage(error: object) -> str:
    from tailbeat.core.errors import sentence

    message = " ".join(str(getattr(error, "format_message", lambda: error)()).split())
    context = getattr(error, "ctx", None)
    command = getattr(context, "command_path", "tailbeat")
    return f"{sentence(message)} Try: {command} --help"


def _fail(line: str, status: int) -> int:
    from tailbeat.core.printable import printable

    sys.stderr.write(f"tailbeat: {printable(line)}\n")
    return status
