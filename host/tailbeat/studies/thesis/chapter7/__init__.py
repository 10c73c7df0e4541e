"""Chapter 7: a rod whose heat is carried along and taken up; D-type law with a lead."""

from __future__ import annotations

from tailbeat.studies.thesis.chapter7 import plants as anticipatory
from tailbeat.studies.thesis.chapter7.claims import heat_claims, printed_claims
from tailbeat.studies.thesis.chapter7.figures import heat_figures, printed_figures
from tailbeat.studies.thesis.example import Example

_KNOWS = frozenset({"step", "iterations", "delta"})

EXAMPLES: tuple[Example, ...] = (
    Example(
        id="ch7-printed",
        chapter=7,
        title="Advection and Monod uptake (7.31), phi clipped below v = 0 unless --uptake",
        law="D-type with lead (7.10)",
        knows=_KNOWS | {"uptake"},
        run=anticipatory.printed,
        settings=anticipatory.printed_settings,
        claims=printed_claims,
        figures=printed_figures,
        weight=4.0,
    ),
    Example(
        id="ch7-heat",
        chapter=7,
        title="The heat equation (7.3): (7.31) without advection and uptake",
        law="D-type with lead (7.10)",
        knows=_KNOWS,
        run=anticipatory.heat,
        settings=anticipatory.heat_settings,
        claims=heat_claims,
        figures=heat_figures,
        weight=3.0,
    ),
)
