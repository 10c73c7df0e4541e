"""Chapter 6: a rod heated at one end and measured at the other; D-type law and zero-phase Q."""

from __future__ import annotations

from tailbeat.studies.thesis.chapter6.claims import claims
from tailbeat.studies.thesis.chapter6.figures import figures
from tailbeat.studies.thesis.chapter6.plants import run, settings
from tailbeat.studies.thesis.example import Example

EXAMPLES: tuple[Example, ...] = (
    Example(
        id="ch6-heat",
        chapter=6,
        title="Heat equation (6.35), driven at one end, measured at the other",
        law="D-type with zero-phase Q (6.31), (6.42)",
        knows=frozenset({"step", "iterations"}),
        run=run,
        claims=claims,
        figures=figures,
        weight=2.0,
        settings=settings,
    ),
)
