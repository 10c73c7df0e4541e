"""All examples of the thesis, in its order."""

from __future__ import annotations

from tailbeat.thesis.chapter2 import examples as chapter2
from tailbeat.thesis.chapter3 import examples as chapter3
from tailbeat.thesis.chapter4 import examples as chapter4
from tailbeat.thesis.chapter5 import examples as chapter5
from tailbeat.thesis.chapter6 import examples as chapter6
from tailbeat.thesis.chapter7 import examples as chapter7
from tailbeat.thesis.chapter8 import examples as chapter8
from tailbeat.thesis.example import Example

EXAMPLES: tuple[Example, ...] = (
    *chapter2.EXAMPLES,
    *chapter3.EXAMPLES,
    *chapter4.EXAMPLES,
    *chapter5.EXAMPLES,
    *chapter6.EXAMPLES,
    *chapter7.EXAMPLES,
    *chapter8.EXAMPLES,
)
