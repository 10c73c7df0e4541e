"""The command ``thesis``: what it takes, refuses and prints, with examples made for it."""

from __future__ import annotations

import importlib
import json
import os
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import pytest
from threadpoolctl import threadpool_limits

from tailbeat.app.cli import run
from tailbeat.studies.thesis import study

STUBS = '''
"""Examples with known answers."""
from functools import partial

import numpy as np

from tailbeat.core.errors import InputError
from tailbeat.studies.thesis import study as progress
from tailbeat.studies.thesis.ledger import LedgerEntry
from tailbeat.studies.thesis.example import (
    Example, ExampleRun, Found, Prepared, Sketch, Statement, VERDICTS,
)
from tailbeat.studies.thesis.picture import Curve, Panel

LONG = "a claim that is far too long for one line of any terminal and is wrapped, word by word"


def run(scale, options):
    if options.step == 0.5:
        raise InputError("half a step is no step.", "Take a whole one.")
    if options.step == 0.25:
        raise MemoryError
    last = 3 if options.iterations is None else options.iterations
    if scale == 1.0 and options.iterations == 666:
        nothing = np.zeros((0, 2))
        return ExampleRun(np.arange(0), nothing, lengths=nothing[:, 0], diverged=0)
    i = np.arange(last + 1)
    errors = scale / (i + 1.0) * (1 + 0.1 * options.seed)
    if options.m is not None:
        errors = errors + options.m
    progress.report_progress(1, 2)
    random = np.random.default_rng(options.seed).normal(size=(300, 300))
    errors[-1] += np.linalg.norm(np.linalg.inv(random) @ random - np.eye(300))  # last bits alone
    if options.precision == "float":
        errors = errors.astype(np.float32).astype(float)
    return ExampleRun(i, errors, lengths=None if options.lengths is None else i + 1.0)


def two(options):
    i = np.arange(1, 4)
    return ExampleRun(i, np.array([[1.0, 2.0], [np.nan, 3.0], [0.5, np.inf]]), diverged=4)


def first(study):
    calls = study.run(iterations=5)
    assert study.run(iterations=5) is calls, "not cached"
    return Found(True, calls.max_abs_error[5])


def said(text, source, found, ours=False):
    entry = LedgerEntry(text, text, source, "a number", "it is right", ours=ours)
    return Statement(entry, found if callable(found) else lambda study: found)


CLAIMS = (
    said("first", "(2.1)", first),
    said(LONG, "Fig. 2.3 and section 2.4", Found(False, [0.5, np.nan], "a note " * 30, True)),
    said("third", "(2.3)", Found(False, "never")),
    said("said by nobody else", "beside (2.3)", Found(True, 4), ours=True),
)
FIGURES = (
    Sketch("2.3", "errors", lambda study: Panel(
        [Curve([0, 1], [1, 0])], {}, contradicts="its numbers"
    )),
)


def forever(options):
    while True:
        pass


def dies(options):
    import os

    os._exit(1)


def made(name, run, knows, claims=(), figures=(), weight=1.0):
    def prepare(setting, options):
        return Prepared({one: getattr(options, one) for one in knows}, lambda: run(options))

    title, law = f"stub {name}", "P (2.3)"
    return Example(
        name, title, law, None, prepare, frozenset(knows), weight, list(claims), list(figures)
    )


EXAMPLES = (
    made("ch2-a", partial(run, 1.0), {"seed", "step", "iterations", "lengths"}, CLAIMS, FIGURES),
    made("ch2-b", partial(run, 2.0), {"iterations", "m", "beta"}, weight=3.0),
    made("ch3-c", two, {"delta"}),
)
SLOW = (*EXAMPLES, made("ch4-d", forever, set(), weight=9.0))
'''


@pytest.fixture
def stubs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "thesis_stubs.py").write_text(STUBS)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(study, "REGISTRY", "thesis_stubs")
    sys.modules.pop("thesis_stubs", None)
    return tmp_path


def not_json(word: str) -> Any:
    raise AssertionError(f"{word} is no JSON")


def document(capsys: pytest.CaptureFixture[str], *words: str) -> Any:
    assert run(["sim", "thesis", *words, "--cores", "1", "--json"]) == 0
    shown = capsys.readouterr()
    assert shown.err == ""
    return json.loads(shown.out, parse_constant=not_json)


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    cores = [] if "--cores" in words else ["--cores", "1"]
    status = run(["sim", "thesis", *words, *cores])
    shown = capsys.readouterr()
    assert status in (1, 2) and shown.out == "" and shown.err.count("\n") == 1
    return shown.err


def test_the_document(stubs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = document(capsys)
    assert [one["id"] for one in found["examples"]] == ["ch2-a", "ch2-b", "ch3-c"]
    first, second, third = found["examples"]
    assert first["law"] == "P (2.3)" and first["iterations"] == [0, 1, 2, 3]
    assert first["max_abs_error"][:3] == pytest.approx([1.1, 0.55, 1.1 / 3], rel=1e-7)
    assert [set(claim) for claim in first["claims"]] == [
        {
            "id",
            "claim",
            "where",
            "quote",
            "computed",
            "criterion",
            "ours",
            "verdict",
            "measured",
            "note",
        }
    ] * 4
    assert [claim["ours"] for claim in first["claims"]] == [False, False, False, True]
    assert first["claims"][0]["measured"] == pytest.approx(1.1 / 6, rel=1e-6)
    assert first["claims"][1]["measured"] == [0.5, None]
    assert second["claims"] == [] and second["executed_max_abs_error"] is None
    assert third["max_abs_error"] == [[1.0, 2.0], [None, 3.0], [0.5, None]]
    assert third["diverged_at"] == 4 and first["diverged_at"] is None
    assert found["verdicts"] == {
        "confirmed": 1, "confirmed under a stated reading": 1, "not confirmed": 1,
        "cannot be decided from the text": 0,
    }  # fmt: skip
    assert found["verdicts_ours"] == {
        "confirmed": 1, "confirmed under a stated reading": 0, "not confirmed": 0,
        "cannot be decided from the text": 0,
    }  # fmt: skip


@pytest.mark.painted
def test_text_fits_a_hundred_columns(stubs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["sim", "thesis", "--cores", "1", "--figures", str(stubs / "new" / "drawn")]) == 0
    shown = capsys.readouterr().out
    lines = shown.splitlines()
    assert max(len(line) for line in lines if str(stubs) not in line) <= 100
    assert lines[0] == "ch2-a: stub ch2-a; P (2.3)"
    assert lines[1] == "max|e| in iteration 0: 1.1, 1: 0.55, 2: 0.3667, 3: 0.275"
    assert "diverged at 4" in shown and "1: 1/2, 2: -/3, 3: 0.5/-" in shown
    assert [line.strip() for line in lines[-4:]] == [
        "claims: confirmed 1, confirmed under a stated reading 1, not confirmed 1, cannot be"
        " decided from the",
        "text 0",
        "beside them, not the thesis's: confirmed 1, confirmed under a stated reading 0, not"
        " confirmed 0,",
        "cannot be decided from the text 0",
    ]
    beside = lines.index(next(line for line in lines if line.startswith("beside the thesis's")))
    assert lines[beside + 2].startswith("said by nobody else")
    assert sum(line.startswith("said by nobody else") for line in lines) == 1
    joined = " ".join(shown.split())
    assert "Fig. 2.3, errors contradicted by the text's own numbers: its numbers" in joined
    assert (stubs / "new" / "drawn" / "fig-2.3.svg").exists()


def test_options_reach_those_that_know_them(
    stubs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("2", "--iterations", "2", "--m", "3", "--seed", "0", "--lengths", "full")
    more = ("--beta", "-1/2", "--step", "2*pi/5000", "--no-claims")
    first, second = document(capsys, *words, *more)["examples"]
    assert first["max_abs_error"] == pytest.approx([1.0, 0.5, 1 / 3], rel=1e-7)
    assert second["max_abs_error"] == pytest.approx([5.2, 4.1, 3 + 2.2 / 3], rel=1e-7)
    assert first["settings"] == {
        "iterations": 2, "lengths": "full", "seed": 0, "step": 2 * 3.141592653589793 / 5000,
        "precision": "double",
    }  # fmt: skip
    assert second["settings"] == {"beta": -0.5, "iterations": 2, "m": 3, "precision": "double"}
    assert first["lengths"] == [1, 2, 3] and first["claims"] == []
    (alone,) = document(capsys, "ch3-c", "--delta", "1/4", "--precision", "float")["examples"]
    assert alone["settings"] == {"delta": 0.25, "precision": "float"}


def test_arrays_have_a_row_even_where_the_first_trial_diverges(
    stubs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (found,) = document(capsys, "ch2-a", "--iterations", "666", "--no-claims")["examples"]
    assert found["iterations"] == [0] and found["max_abs_error"] == [[None, None]]
    assert found["lengths"] == [None] and found["executed_max_abs_error"] is None
    assert found["diverged_at"] == 0


@pytest.mark.parametrize(("columns", "width"), [(60, 72), (80, 80), (120, 120), (250, 120)])
def test_text_is_as_wide_as_the_terminal(
    stubs: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
    columns: int, width: int,
) -> None:  # fmt: skip
    import shutil

    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    size = os.terminal_size((columns, 24))
    monkeypatch.setattr(shutil, "get_terminal_size", lambda *, fallback=None: size)
    assert run(["sim", "thesis", "ch2-a", "--cores", "1", "--iterations", "9"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert width - 8 <= max(map(len, lines)) <= width
    assert lines[1].startswith("settings: iterations 9, seed 1, precision double")


def test_many_numbers_have_a_line_of_their_own(
    stubs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    at: Any = importlib.import_module("thesis_stubs")
    many = at.said("many", "(2.1)", at.Found(True, [0.1234] * 30, "a note"))
    at.EXAMPLES = (at.made("ch2-a", at.two, (), [many]),)
    assert run(["sim", "thesis", "--cores", "1"]) == 0
    lines = capsys.readouterr().out.splitlines()
    row = next(i for i, line in enumerate(lines) if line.startswith("many"))
    assert lines[row].endswith("see below") and lines[row + 1].startswith("  measured: 0.1234, ")
    assert sum(line.count("0.1234") for line in lines[row + 1 : row + 4]) == 30
    assert "  a note" in lines[row + 3 : row + 5] and max(map(len, lines)) <= 100


def test_claims_judge_the_thesiss_settings(stubs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    asked = document(capsys, "ch2-a", "--seed", "9", "--iterations", "1")["examples"][0]
    plain = document(capsys, "ch2-a")["examples"][0]
    assert asked["claims"] == plain["claims"] and asked["iterations"] == [0, 1]


def test_chapters_by_number_or_name(stubs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for word in ("2", "ch2"):
        ids = [one["id"] for one in document(capsys, word)["examples"]]
        assert ids == ["ch2-a", "ch2-b"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["9"], "there is no '9'. Chapters are 2, 3; examples ch2-a, ch2-b, ch3-c."),
        (["ch2-b", "--seed", "4"], "ch2-b does not know --seed. It knows --beta, --iter"),
        (["ch2-b", "--step", "1"], "ch2-b does not know --step. It knows --beta, --iter"),
        (["3", "--m", "4"], "none of these examples knows --m. They know --delta."),
        (["--step", "0"], "--step 0 is 0. Give a number above 0."),
        (["--beta", "1-1"], "--beta 1-1 is 0. Give any other number."),
        (["--beta", "1/0"], "'1/0' has no finite value."),
        (["--uptake", "none"], "'none' is not one of 'monod', 'abs', 'clip'"),
        (["--step", "1-2"], "--step 1-2 is -1."),
        (["--step", "1/0"], "'1/0' has no finite value."),
        (["--step", "exit()"], "'exit()' has 'exit()', which is not allowed."),
        (["--step", "nan"], "'nan' has the name 'nan', which is not allowed."),
        (["--step", "i"], "'i' has the name 'i', which is not allowed."),
        (["--delta", "0"], "--delta 0 is 0. Give a number above 0."),
        (["--iterations", "0"], "--iterations 0 is out of range. Give 1 to 10000."),
        (["--iterations", "10001"], "--iterations 10001 is out of range."),
        (["--m", "-1"], "--m -1 is out of range. Give 0 to 15."),
        (["--m", "16"], "--m 16 is out of range."),
        (["--seed", "-1"], "--seed -1 is out of range."),
        (["--cores", "0"], "Try: tailbeat sim thesis --help"),
        (["--precision", "half"], "'half' is not one of 'double', 'float'"),
        (["--lengths", "short"], "'short' are no lengths of trials. Lengths are full, uniform or"),
        (["--lengths", "pattern:x+1"], "'x+1' has the name 'x', which is not allowed."),
        (["2", "--step", "0.5"], "ch2-a: half a step is no step. Take a whole one."),
        (["2", "--step", "0.25"], "ch2-a: these settings are more than this computer can compute."),
    ],
)  # fmt: skip
def test_what_makes_no_sense_is_refused_in_one_line(
    stubs: Path, capsys: pytest.CaptureFixture[str], words: list[str], message: str
) -> None:
    assert message in refused(capsys, *words)


def test_what_a_process_refuses_is_told_the_same(
    stubs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = refused(capsys, "2", "--step", "0.5", "--cores", "2")
    assert told == "tailbeat: ch2-a: half a step is no step. Take a whole one.\n"


def test_a_folder_that_is_a_file_is_refused(
    stubs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (stubs / "file").write_text("")
    assert "cannot use" in refused(capsys, "--figures", str(stubs / "file"))


def test_results_do_not_depend_on_cores(stubs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Byte for byte, linear algebra included; the heaviest begins first and is printed second."""
    shown = []
    for cores in ("1", "2"):
        assert run(["sim", "thesis", "--json", "--seed", "3", "--cores", cores]) == 0
        shown.append(capsys.readouterr().out)
    assert shown[0] == shown[1] != ""


def test_results_do_not_depend_on_threads(stubs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shown = []
    for threads in (1, 2):
        with threadpool_limits(limits=threads):
            shown.append(document(capsys, "2", "--no-claims"))
    assert shown[0] == shown[1]


def test_progress_rises_to_the_end(stubs: Path) -> None:
    orders = [study.Order(name, study.ExampleOptions(), registry="thesis_stubs")
              for name in ("ch2-a", "ch2-b", "ch3-c")]  # fmt: skip
    for cores in (1, 2):
        parts: list[float] = []
        study.run_many(orders, [1.0, 3.0, 1.0], cores, parts.append)
        assert parts == sorted(parts) and parts[-1] == pytest.approx(1.0)
        if cores == 1:
            found = [round(5 * part, 6) for part in parts if part < 0.19]  # of the first
            assert found == [0.05, 0.325, 0.55, 0.775]  # half of its run, each of its claims


def script(folder: Path, body: str) -> subprocess.CompletedProcess[str]:
    """The command with two cores in a session of its own; ``body`` changes it before."""
    code = textwrap.dedent(
        """
        import os, signal, sys
        sys.path.insert(0, sys.argv[1])
        from tailbeat.app.cli import run
        from tailbeat.studies.thesis import study
        import thesis_stubs
        study.REGISTRY = "thesis_stubs"
        """
    ) + textwrap.dedent(body)
    path = folder / "script.py"
    code += "\nif __name__ == '__main__':\n    sys.exit(run(['thesis', '--cores', '2']))\n"
    path.write_text(code)
    return subprocess.run(
        [sys.executable, str(path), str(folder)],
        capture_output=True, text=True, start_new_session=True, timeout=600,
    )  # fmt: skip


def test_ctrl_c_ends_all_of_it_with_one_line(stubs: Path) -> None:
    """Pressed when the first example is done and another goes on for ever."""
    done = script(stubs, """
        thesis_stubs.EXAMPLES = thesis_stubs.SLOW
        from tailbeat.core import parallel as pool
        really = pool.wait
        def wait(running, **how):
            ready = really(running, **how)
            if ready[0]:
                os.killpg(0, signal.SIGINT)
            return ready
        pool.wait = wait
        """)  # fmt: skip
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr == "tailbeat: stopped; nothing is kept. Run it again.\n"


def test_a_process_that_dies_is_told(stubs: Path) -> None:
    done = script(stubs, """
        dying = thesis_stubs.made("ch4-d", thesis_stubs.dies, set(), weight=9.0)
        thesis_stubs.EXAMPLES = (*thesis_stubs.EXAMPLES, dying)
        """)  # fmt: skip
    assert done.returncode == 1 and done.stderr.count("\n") == 1
    assert "a process that computed examples has died" in done.stderr


@pytest.mark.painted
def test_a_real_example(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("ch8-sim-4", "--iterations", "6", "--paper", str(tmp_path))
    (found,) = document(capsys, *words)["examples"]
    assert found["max_abs_error"] == pytest.approx(
        [0.0791, 0.0353, 0.0139, 0.0049, 0.0018, 0.0010, 0.0010], abs=2e-4
    )
    assert found["iterations"] == list(range(7)) and len(found["claims"]) >= 10
    drawn = {Path(figure["path"]).name for figure in found["figures"]}
    assert drawn >= {"fig-8.3.pdf", "fig-8.4.pdf", "fig-8.5.pdf", "fig-8.9.pdf", "fig-A.1.pdf"}
    for ending in ("pdf", "svg", "png", "txt"):
        assert (tmp_path / f"fig-8.9.{ending}").stat().st_size > 50
    assert (tmp_path / "contact-sheet.png").stat().st_size > 10_000
    assert (tmp_path / "thesis.pdf").read_bytes().startswith(b"%PDF")
    page = (tmp_path / "thesis.html").read_text("utf-8")
    assert all(f'id="claim-{claim["id"]}"' in page for claim in found["claims"])
    assert page.count("<svg") == 5 and "The end of the reference (8.31) is infeasible" in page
    assert "until 38.47 s" in page and "The plant of chapter 7" not in page, "of what was judged"
