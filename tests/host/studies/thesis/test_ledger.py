"""The ledger of claims, and the standard of continuous-time theorems."""

from __future__ import annotations

from collections import Counter

import pytest

from tailbeat.studies.thesis.ledger import (
    SampledRun,
    entries,
    figure_comparisons,
    in_continuous_time,
)
from tailbeat.studies.thesis.registry import EXAMPLES


def test_every_claim_has_one_check() -> None:
    checked = Counter(one.entry.id for example in EXAMPLES for one in example.claims)
    assert checked == Counter(list(entries()))


def test_every_claim_says_what_is_computed_and_by_which_criterion() -> None:
    for entry in entries().values():
        assert entry.claim and entry.where and entry.computed and entry.criterion, entry.id
        assert entry.id[0] in "23456789" and not entry.quote.endswith("."), entry.id
        assert len(entry.quote.split()) <= 30, "at most a sentence"


def test_distinct_claims() -> None:
    """61 were counted by an independent reading; Remark 8.2 and chapters 2 to 6 have more."""
    thesis = [entry for entry in entries().values() if not entry.ours]
    assert 61 <= len(thesis) <= 75
    assert len({entry.claim for entry in thesis}) == len(thesis)


@pytest.mark.parametrize(
    ("runs", "found"),
    [
        ([(0.1, True, None), (0.05, True, None)], (True, True)),
        ([(0.1, True, 5), (0.05, True, 9)], (False, True)),
        ([(0.1, False, 5), (0.05, True, None)], (False, True)),
        ([(0.1, True, 5), (0.05, True, 5), (0.02, True, 7)], (False, True)),
        ([(0.1, True, 9), (0.05, True, 5)], (False, False)),
        ([(0.1, True, 5), (0.05, True, 5)], (False, False)),
        ([(0.1, True, 9), (0.05, True, 5), (0.02, True, None)], (False, False)),
        ([(0.1, True, 5), (0.05, False, 9)], (False, False)),
        ([(0.05, True, None), (0.1, True, 5)], (False, True)),
        ([(0.1, False, None), (0.05, True, None)], (False, True)),
    ],
)
def test_the_standard_of_continuous_time(
    runs: list[tuple[float, bool, int | None]], found: tuple[bool, bool]
) -> None:
    assert in_continuous_time([SampledRun(*run) for run in runs]) == found


LAST = {2: 10, 3: 5, 4: 13, 5: 6, 6: 3, 7: 7, 8: 9}
NOT_COMPUTED = {"2.1", "8.1", "8.2"}  # drawings; 8.10 to 8.12: a photograph and the tank


def test_every_numbered_figure_is_there_once() -> None:
    drawn = Counter(sketch.number for example in EXAMPLES for sketch in example.figures)
    asked = {f"{chapter}.{n}" for chapter, last in LAST.items() for n in range(1, last + 1)}
    assert set(drawn) >= (asked - NOT_COMPUTED) | {"A.1"}
    assert max(drawn.values()) == 1
    for example in EXAMPLES:
        for sketch in example.figures:
            assert sketch.caption.endswith(".") and bool(sketch.name) == ("." in sketch.number)


def test_laws_that_never_fly() -> None:
    """The feedback laws of chapters 4 and 5, and a study's; the board has all others."""
    assert {example.chapter for example in EXAMPLES if not example.on_board} == {4, 5, 9}
    assert all(not example.on_board for example in EXAMPLES if example.chapter in (4, 5))


def test_every_numbered_figure_was_compared_with_the_text() -> None:
    numbered = {one.number for example in EXAMPLES for one in example.figures if one.name}
    assert set(figure_comparisons()) == numbered
