"""Messages of the session in the words of the page, and what made each trial's input."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from tailbeat.app.web.state import on_the_page
from tailbeat.app.web.trials import last_start, made_by

from .test_ui_page import row

HERE = " on this page"
CHANGE = f"'Change the reference'{HERE}"
END = "End this page before that command: Ctrl-C where tailbeat session web runs."


@pytest.mark.parametrize(
    ("words", "shown"),
    [
        ("Swim one: tailbeat trial run", "Swim one: START"),
        ("trial 3 is kept: tailbeat trial learn", "trial 3 is kept: START"),
        ("FAULT. Then: tailbeat board clear", f"FAULT. Then: 'Clear the fault'{HERE}"),
        ("tailbeat params set AMP_MAX_RAD 0.68, tailbeat params save", f"'Parameters'{HERE}"),
        ("Print all names: tailbeat params list", f"Print all names: 'Parameters'{HERE}"),
        ("Stop it first: tailbeat board disarm", "Stop it first: ABORT"),
        ("no reference. tailbeat reference upload thesis", f"no reference. {CHANGE}"),
        ("tailbeat reference upload thesis:0.06,50.", f"{CHANGE}."),
        ("tailbeat reference upload a/my.csv, or", f"{CHANGE}, or"),
        (
            "Again with 'tailbeat session commission'",
            "Again with START with 'Commissioning: again'",
        ),
        ("learned nothing", "learned nothing"),
        ("no. Begin again with the same command.", "no. Begin again with START."),
        ("tailbeat report prints it", f"'Write the report'{HERE} prints it"),
        ("a film: tailbeat camera track FILM", "a film: tailbeat camera track FILM"),
    ],
)
def test_what_the_page_can_do_itself_is_said_so(words: str, shown: str) -> None:
    assert on_the_page(words) == shown


@pytest.mark.parametrize(
    "command",
    ["trial learn --restore-best", "trial speeds 3 FILE", "session resume", "session trim",
     "board key set", "info", "params reset"],
)  # fmt: skip
def test_what_needs_the_port_says_so_once(command: str) -> None:
    shown = on_the_page(f"To do that: tailbeat {command}.")
    assert shown == on_the_page(shown)
    assert shown.endswith(END) and len(re.findall(re.escape(END), shown)) == 1
    assert "'Parameters' on this page reset" not in shown


def test_each_row_says_what_made_its_input() -> None:
    rows = [
        row(1, 0.07, input="first", file="0001.ulg"),
        row(2, 0.04, input="uploaded", file="0002.ulg"),
        row(3, 0.03, input="uploaded", file="0003.ulg"),
        row(4, 0.03, input="law", file="0004.ulg"),
        row(5, 0.03, input="restored", file="0005.ulg"),
        row(6, 0.03, input="uploaded", file="0006.ulg"),
    ]
    laws = [("p", "nothing is known"), ("model", "re-fitted on 1 trial"), ("model", "on 2"),
            ("model", "on 3"), ("best", "worse than before"), ]  # fmt: skip
    entries = [
        entry
        for number, (law, why) in enumerate(laws, 1)
        for entry in (
            {"what": "input", "trial": number, "law": law, "why": why},
            {"what": "begun", "trial": number, "law": law},
            {"what": "swum", "trial": number, "file": f"{number:04d}.ulg"},
        )
    ]
    assert made_by(rows, entries) == (
        "P law on the board (nothing is known)",
        "model-based (re-fitted on 1 trial)",
        "model-based",
        "P law on the board",  # the laptop was gone: the board went on alone
        "best input so far (worse than before)",
        "uploaded",
    )
    assert made_by([replace(rows[0], input="")], []) == ("not known",)


def test_the_last_start_is_the_cameras() -> None:
    pose = {"source": "camera", "x_m": 0.2, "y_m": -0.01, "heading_rad": 0.05}
    entries = [{"what": "swum", "pose": pose}, {"what": "swum", "pose": {"source": "imu"}}]
    assert last_start(entries) == (0.2, -0.01, 0.05)
    assert last_start(entries[1:]) is None
