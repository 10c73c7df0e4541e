"""Makes the plain comments of a C header ones that Doxygen reads: the file's name is the argument.

A comment before a declaration belongs to it; one after code on the same line belongs to that code;
the first one of a file describes the file.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

_COMMENT = re.compile(r"/\*(?!\*)(.*?)\*/", re.DOTALL)
_SPECIAL = re.compile(r"([\\@<>&$#%])")


def documented(text: str) -> str:
    """The header with its comments marked; line numbers stay."""
    pieces, last = [], 0
    for match in _COMMENT.finditer(text):
        line_start = text.rfind("\n", 0, match.start()) + 1
        code_before = text[line_start : match.start()].strip()
        opening = "/**< " if code_before else "/** @file\n" if match.start() == 0 else "/**"
        body = _SPECIAL.sub(r"\\\1", match[1])
        pieces += [text[last : match.start()], opening, body, "*/"]
        last = match.end()
    return "".join((*pieces, text[last:]))


if __name__ == "__main__":
    sys.stdout.write(documented(Path(sys.argv[1]).read_text(encoding="utf-8")))
