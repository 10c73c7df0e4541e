"""All examples of the thesis, in its order."""

from __future__ import annotations

from tailbeat.studies.thesis import (
    chapter2,
    chapter3,
    chapter4,
    chapter5,
    chapter6,
    chapter7,
    chapter8,
)
from tailbeat.studies.thesis.example import Example

_CHAPTERS = (chapter2, chapter3, chapter4, chapter5, chapter6, chapter7, chapter8)
EXAMPLES: tuple[Example, ...] = tuple(one for chapter in _CHAPTERS for one in chapter.EXAMPLES)
