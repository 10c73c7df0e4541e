"""Checks spelling, words and the length of sentences in the documentation and in every text that
the host tool and the firmware show.

The words are those of tools/prose_words.toml. Prints one line per finding and exits with 1 when
there is one.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

from prose_texts import MASK, Text, page_files, texts

TABLE = Path(__file__).resolve().parent / "prose_words.toml"
SPELLED = ("host/tailbeat", "firmware", "hal", "sim", "wire", "tools")
SENTENCE_END = re.compile(r"(?<=[.?!])[)\"]*\s+|\n+|[,:;]\s+(?=\d+ = )")


@dataclass(frozen=True)
class Word:
    """A word that is not used. ``find``: a regular expression, in which a space is any white space.
    ``allow``: contexts in which it is right; ``files``: patterns of paths in which it is right."""

    find: str
    use: str
    allow: tuple[str, ...] = ()
    files: tuple[str, ...] = ()

    def found(self, text: str) -> Iterator[re.Match[str]]:
        """Where a text has the word, outside the contexts in which it is right."""
        spans = [one.span() for rule in self.allow for one in pattern(rule).finditer(text)]
        for one in pattern(self.find).finditer(text):
            if not any(start <= one.start() and one.end() <= end for start, end in spans):
                yield one


@dataclass(frozen=True)
class Table:
    """tools/prose_words.toml."""

    words_max: int
    spelled_right: tuple[str, ...]
    words: tuple[Word, ...]

    @classmethod
    def read(cls, path: Path) -> Table:
        """Raises KeyError or TypeError when a field is missing or unknown."""
        content = tomllib.loads(path.read_text(encoding="utf-8"))
        words = tuple(Word(**{**one, **_tuples(one)}) for one in content["word"])
        return cls(content["words_max"], tuple(content["spelled_right"]), words)


def _tuples(fields: dict[str, Any]) -> dict[str, tuple[str, ...]]:
    """Of the fields that are lists."""
    return {key: tuple(value) for key, value in fields.items() if isinstance(value, list)}


def pattern(rule: str) -> re.Pattern[str]:
    """Of a rule of the table."""
    return re.compile(rule.replace(" ", r"\s+"), re.IGNORECASE)


def spelling(root: Path, table: Table) -> Iterator[str]:
    """What codespell finds."""
    files = page_files(root)
    folders = [root / name for name in SPELLED if (root / name).is_dir()]
    command = [
        sys.executable, "-m", "codespell_lib", "--quiet-level", "7", "--skip", "__pycache__",
        "--ignore-words-list", ",".join(table.spelled_right), *map(str, files), *map(str, folders),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.stderr:
        yield f"codespell: {done.stderr.strip()}"
    for line in done.stdout.splitlines():
        yield line.removeprefix(f"{root}/").replace(" ==> ", " -> ")


def words(text: Text, table: Table) -> Iterator[str]:
    """Words that are not used."""
    for word in table.words:
        if any(fnmatch(text.path, rule) for rule in word.files):
            continue
        for one in word.found(text.text):
            found = " ".join(one[0].split())
            yield f"{text.path}:{text.line_of(one.start())}: {found} -> {word.use}"


def word_count(sentence: str) -> int:
    """What is masked counts as one word, signs between as none."""
    return sum(bool(re.search(rf"\w|{MASK}", part)) for part in sentence.split())


def lengths(text: Text, table: Table) -> Iterator[str]:
    """Sentences of a message that are too long. A line with columns is a table, not a sentence."""
    for sentence in SENTENCE_END.split(text.text) if text.is_message else ():
        count = word_count(sentence)
        if count > table.words_max and "   " not in sentence.strip():
            begin = " ".join(sentence.split()[:6])
            yield (
                f"{text.path}:{text.line}: {count} words in '{begin} …' ->"
                f" at most {table.words_max}: make two sentences"
            )


def findings(root: Path, table: Table) -> list[str]:
    """Everything that is wrong below ``root``."""
    found = list(spelling(root, table))
    for text in texts(root):
        found += [*words(text, table), *lengths(text, table)]
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    default = Path(__file__).resolve().parent.parent
    parser.add_argument("root", type=Path, nargs="?", default=default)
    parser.add_argument("--table", type=Path, default=TABLE)
    options = parser.parse_args()
    table = Table.read(options.table)
    found = findings(options.root.resolve(), table)
    print("\n".join(found) or "prose: all spelled and worded as agreed")
    sys.exit(bool(found))


if __name__ == "__main__":
    main()
