"""Lengths of trials and typed arithmetic: right values, and nothing of Python but arithmetic."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tailbeat.core.errors import InputError
from tailbeat.studies.thesis.options import expression, parse

NUMBERS = st.integers(0, 50).map(str) | st.floats(0, 1e3).map(repr)


def drawn(seed: int, iteration: int) -> float:
    return 1000.0 * seed + iteration


def pattern(text: str, iteration: int) -> float:
    return parse(f"pattern:{text}", 50.0, drawn, 1)(iteration)


def grown(inner: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    two = st.tuples(inner, st.sampled_from(["+", "-", "*", "/", "//", "%", "<", ">=", "=="]), inner)
    return st.one_of(
        two.map(lambda parts: f"({' '.join(parts)})"),
        inner.map(lambda one: f"(-{one})"),
        inner.map(lambda one: f"abs({one})"),
        st.tuples(inner, inner).map(lambda both: f"max({both[0]}, {both[1]})"),
        st.tuples(inner, inner, inner).map(lambda abc: f"({abc[0]} if {abc[1]} else {abc[2]})"),
    )


@given(st.recursive(NUMBERS | st.just("i"), grown, max_leaves=8), st.integers(0, 200))
def test_values_are_those_of_python_on_floats(text: str, iteration: int) -> None:
    """Python itself is the reference: eval of a text that was made here."""
    if len(text) > 300:
        return
    names = {"abs": abs, "max": max, "i": float(iteration)}
    try:
        wanted = float(eval(text, {"__builtins__": {}}, names))
    except ZeroDivisionError:
        wanted = math.nan
    value = expression(text, ("i",))
    if math.isfinite(wanted):
        assert value({"i": float(iteration)}) == wanted
    else:
        with pytest.raises(InputError, match="no finite value at i ="):
            value({"i": float(iteration)})


def test_full_drawn_and_patterns() -> None:
    assert parse("full", 50.0, drawn, 3)(7) == 50.0
    assert parse("uniform", 50.0, drawn, 3)(7) == 3007.0
    assert parse("random", 50.0, drawn, 3)(8) == 3008.0
    assert [pattern("45+(7*i+3)%11", i) for i in range(4)] == [48.0, 55.0, 51.0, 47.0]
    assert pattern("2 if i % 2 else 1.5", 3) == 2.0
    assert pattern("2 if i % 2 == 1 and not i > 5 else 1.5", 7) == 1.5
    assert pattern("1 < i <= 3", 3) == 1.0
    assert pattern("2+0.25*sin(i)", 2) == 2 + 0.25 * math.sin(2.0)
    assert pattern("min(9, i, 4) + round(2.6) + ceil(0.1) + floor(1.9) + sqrt(16)", 5) == 13.0
    assert expression("2*pi/5000")({}) == 2 * math.pi / 5000
    assert expression("2**-3")({}) == 0.125


@pytest.mark.parametrize(
    "text",
    [
        "__import__('os').system('true')",
        "().__class__",
        "i.__class__",
        "i.real",
        "[i][0]",
        "{1: 2}",
        "'a'*3",
        "b'x'",
        "f'{i}'",
        "lambda: 1",
        "(x := 5)",
        "[j for j in (1, 2)]",
        "open('f')",
        "eval('1')",
        "abs(*(1, 2))",
        "abs(i, key=1)",
        "abs()",
        "abs(1, 2)",
        "max()",
        "sin",
        "max",
        "e",
        "j",
        "1j",
        "None",
        "...",
        "i in (1, 2)",
        "i is 1",
        "i & 1",
        "i << 100",
        "~i",
        "i @ i",
        "await i",
        "i; i",
        "i = 1",
        "",
        " ",
        "((((",
        "\0",
        "9" * 301,
        "1e999999",
        "9" * 290 + "**" + "9",
        "inf",
        "nan",
    ],
)
def test_everything_else_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(InputError) as refused:
        pattern(text, 1)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("text", ["-" * 250 + "1", "(" * 140 + "1" + ")" * 140, "1" + "+1" * 149])
def test_what_is_deep_is_a_number_or_refused(text: str) -> None:
    try:
        assert pattern(text, 1) in (1.0, 150.0)
    except InputError as refused:
        assert "no arithmetic expression" in str(refused)


@pytest.mark.parametrize(
    ("text", "iteration"),
    [
        ("1/i", 0),
        ("1//i", 0),
        ("1%i", 0),
        ("10**10**10**i", 1),
        ("9.0**9999999", 0),
        ("1e308*10", 0),
        ("1e308*10-1e308*10", 0),
        ("(0-1)**0.5", 0),
        ("abs((0-8)**(1/3))", 0),
        ("sqrt(0-1)", 0),
        ("0**-1", 0),
        ("ceil(1e308*10)", 0),
        ("sin(1e308*10)", 0),
    ],
)
def test_what_has_no_finite_value_is_refused_when_it_comes(text: str, iteration: int) -> None:
    length = parse(f"pattern:{text}", 50.0, drawn, 1)
    with pytest.raises(InputError, match=f"no finite value at i = {iteration}"):
        length(iteration)


@pytest.mark.parametrize("text", ["0", "-1", "5-i", "i > 5"])
def test_a_trial_without_length_is_refused_in_its_iteration(text: str) -> None:
    length = parse(f"pattern:{text}", 50.0, drawn, 1)
    with pytest.raises(InputError, match="in iteration 5"):
        length(5)


@pytest.mark.parametrize("text", ["", "half", "FULL", "uniform:3", "pattern", "45"])
def test_other_words_are_told_what_is_allowed(text: str) -> None:
    with pytest.raises(InputError, match="full, uniform or pattern:EXPR"):
        parse(text, 50.0, drawn, 1)


@given(st.text(max_size=40))
def test_no_text_does_anything_but_a_number_or_a_refusal(text: str) -> None:
    try:
        found = pattern(text, 3)
    except InputError:
        return
    assert 0 < found < math.inf
