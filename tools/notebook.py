"""Executes the notebook of the docs: ``--write`` stores what comes out, else what is stored must
come out again (texts; a picture's bytes depend on the fonts at hand).

A number may differ by one in its last digit: the last bit of a sine differs between processors,
which over five trials can move a servo pulse by one tick of its timer.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
import tempfile
from decimal import Decimal
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient

_NUMBER = re.compile(r"-?\d+\.?\d*")
NOTEBOOK = Path(__file__).parent.parent / "docs" / "reference" / "fish-api.ipynb"


def executed(path: Path) -> Any:
    """The notebook as it comes out now, with a trial library and keys of its own."""
    book = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        for name in ("TAILBEAT_LOGBOOK", "TAILBEAT_KEYS", "IPYTHONDIR"):
            os.environ[name] = folder
        resources = {"metadata": {"path": folder}}
        NotebookClient(
            book, timeout=2400, kernel_name="python3", resources=resources, coalesce_streams=True
        ).execute()
    for cell in book.cells:
        cell.metadata = {}  # else it tells when it ran
    spec = {"display_name": "Python 3", "language": "python", "name": "python3"}
    book.metadata = {"kernelspec": spec}
    return book


def texts(book: Any) -> list[str]:
    """What every cell has printed or shown in words, in order."""
    found = []
    for cell in book.cells:
        for output in cell.get("outputs", []):
            shown = output.get("data", {})
            words = "" if "image/png" in shown else shown.get("text/plain", "")
            found.append(output.get("text") or words)
    return found


def agree(was: str, now: str) -> bool:
    """The same words, and numbers with as many digits that differ by one in the last at most."""
    if _NUMBER.sub("#", was).split() != _NUMBER.sub("#", now).split():
        return False
    pairs = zip(_NUMBER.findall(was), _NUMBER.findall(now), strict=True)
    return all(_differ_by_one_at_most(Decimal(a), Decimal(b)) for a, b in pairs)


def _differ_by_one_at_most(was: Decimal, now: Decimal) -> bool:
    digit = was.as_tuple().exponent
    return digit == now.as_tuple().exponent and abs(was - now) <= Decimal((0, (1,), int(digit)))


def main() -> int:
    """Exit status 1: it does not come out as stored."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="store what comes out")
    book = executed(NOTEBOOK)
    if parser.parse_args().write:
        nbformat.write(book, NOTEBOOK)
        return 0
    stored = texts(nbformat.read(NOTEBOOK, as_version=4))
    for number, (was, now) in enumerate(zip(stored, texts(book), strict=True)):
        if not agree(was, now):
            sys.stderr.write(f"output {number} was\n{was}\nand is\n{now}\n")
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
