"""The command line: ``tailbeat``. A thin skin over the library.

Only what Python has loaded already is imported here: Ctrl-C is caught from ``main`` on.
"""

from __future__ import annotations

import sys

_INTERRUPTED = 130


def main() -> None:
    """Entry point. Exit status: 0 done, 1 refused or failed, 2 wrongly called, 130 Ctrl-C."""
    import gc
    import os

    # Its matrices are small: a second thread of BLAS does nothing but wait for the first.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        status = run()
    except KeyboardInterrupt:  # before the first command was known
        status = _INTERRUPTED
    gc.freeze()  # what is loaded is not looked through once more at the end, for 20 ms
    sys.exit(status)


def run(arguments: list[str] | None = None) -> int:
    """Runs one command and returns its exit status. An error is one line on stderr; with --json
    also one JSON document on stdout, together with what the command has computed."""
    import gc
    from contextvars import copy_context

    gc.disable()  # until the command begins: what is loaded stays, looking through it takes 10 ms
    from tailbeat.app.cli.app import run_command

    words = sys.argv[1:] if arguments is None else arguments
    return copy_context().run(run_command, words)  # what is set for it ends with it
