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
    chapter9,
)
from tailbeat.studies.thesis.example import Example
from tailbeat.studies.thesis.figures import chapter2 as figures2
from tailbeat.studies.thesis.figures import chapter3 as figures3
from tailbeat.studies.thesis.figures import chapter4 as figures4
from tailbeat.studies.thesis.figures import chapter5 as figures5
from tailbeat.studies.thesis.figures import chapter6 as figures6
from tailbeat.studies.thesis.figures import chapter7 as figures7
from tailbeat.studies.thesis.figures import chapter8 as figures8
from tailbeat.studies.thesis.figures import chapter9 as figures9

_CHAPTERS = (chapter2, chapter3, chapter4, chapter5, chapter6, chapter7, chapter8, chapter9)
EXAMPLES: tuple[Example, ...] = tuple(one for chapter in _CHAPTERS for one in chapter.EXAMPLES)
FIGURES = (figures2, figures3, figures4, figures5, figures6, figures7, figures8, figures9)
"""The modules that give the examples their figures."""
