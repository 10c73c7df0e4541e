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

EXAMPLES: tuple[Example, ...] = (
    *chapter2.EXAMPLES,
    *chapter3.EXAMPLES,
    *chapter4.EXAMPLES,
    *chapter5.EXAMPLES,
    *chapter6.EXAMPLES,
    *chapter7.EXAMPLES,
    *chapter8.EXAMPLES,
)
