"""All examples of the thesis, in its order."""

from __future__ import annotations

from tailbeat.studies.thesis.chapter2 import examples as chapter2
from tailbeat.studies.thesis.chapter3 import examples as chapter3
from tailbeat.studies.thesis.chapter4 import examples as chapter4
from tailbeat.studies.thesis.chapter5 import examples as chapter5
from tailbeat.studies.thesis.chapter6 import examples as chapter6
from tailbeat.studies.thesis.chapter7 import examples as chapter7
from tailbeat.studies.thesis.chapter8 import examples as chapter8
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
