"""The command line: one JSON document or one quiet line, errors as one line on stderr."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tailbeat.app.cli import run
from tailbeat.link.messages import BOARD_KINDS
from tailbeat.sim.board import SimBoard, SimTransport


@pytest.fixture(scope="module")
def simulated() -> SimBoard:
    """One board for all commands of this module, in virtual time."""
    return SimBoard("tank")


class Shell:
    """Runs commands and checks what every command promises."""

    def __init__(self, capsys: pytest.CaptureFixture[str], url: str | None) -> None:
        self.capsys, self.url = capsys, url

    def line(self, *words: str) -> list[str]:
        return [*words, *(["--connect", self.url] if self.url else [])]

    def text(self, *words: str) -> str:
        assert run(self.line(*words)) == 0
        out, err = self.capsys.readouterr()
        assert err == ""
        return out

    def json(self, *words: str) -> Any:
        return json.loads(self.text(*words, "--json"))

    def fails(self, *words: str, status: int = 1) -> str:
        assert run(self.line(*words)) == status
        out, err = self.capsys.readouterr()
        assert out == ""
        assert err.startswith("tailbeat: ")
        assert err.count("\n") == 1
        return err


@pytest.fixture
def board(
    capsys: pytest.CaptureFixture[str], simulated: SimBoard, monkeypatch: pytest.MonkeyPatch
) -> Shell:
    monkeypatch.setattr("tailbeat.board.fish.open_transport", lambda url: SimTransport(simulated))
    return Shell(capsys, "the board")


@pytest.fixture
def alone(capsys: pytest.CaptureFixture[str]) -> Shell:
    return Shell(capsys, None)


def test_a_session(board: Shell, alone: Shell, tmp_path: Path) -> None:
    trial = tmp_path / "swim.csv"
    trial.write_text("t_s,v_m_s\n0,0\n2,0.06\n8,0.06\n10,0\n")
    assert board.json("info")["status"]["state"] == "IDLE"
    assert board.json("params", "set", "AMP_MAX_RAD", "0.75")["value"] == 0.75
    assert board.json("params", "set", "ilc_lead", "1") == {
        "name": "ILC_LEAD", "value": 1.0, "unit": "beats",
    }  # fmt: skip
    assert board.json("reference", "check", str(trial))["problems"] == []
    assert board.text("reference", "upload", str(trial)).startswith("uploaded swim: 10 beats")
    assert board.json("reference", "show")["beats"] == 10
    assert board.json("board", "arm")["state"] == "ARMED"
    assert board.json("board", "disarm")["state"] == "IDLE"
    for iteration in (1, 2):
        outcome = board.json("trial", "run")
        assert (outcome["iteration"], outcome["end"]) == (iteration, "complete")
        dry = board.json("learn", "--dry-run")
        learned = board.json("learn")
        assert (
            np.array(dry["amplitude_rad"], np.float32).tobytes()
            == np.array(learned["amplitude_rad"], np.float32).tobytes()
        )
        assert dry["max_abs_error_m_s"] == learned["max_abs_error_m_s"]
    assert board.json("learn", "--restore-best")["restored"] is True
    assert [t["number"] for t in board.json("trial", "list")["trials"]] == [1, 2]
    folder = board.json(
        "experiment", "new", "--reference", str(trial), "--root", str(tmp_path / "e")
    )["folder"]
    files = board.json("trial", "pull", "--all", "--into", folder)["files"]
    assert [Path(path).name for path in files] == ["0001.ulg", "0002.ulg"]
    assert board.json("trial", "show", "2")["iteration"] == 2
    assert alone.json("trial", "show", files[0])["number"] == 1
    assert "trial 1, iteration 1, simulated: complete" in alone.text("trial", "show", files[0])
    alone.text("experiment", "note", folder, "went well")
    listed = alone.json("experiment", "list", "--root", str(tmp_path / "e"))["experiments"]
    assert (listed[0]["trials"], listed[0]["damaged"]) == (2, [])
    assert len(alone.json("experiment", "export", folder, "--format", "csv")["files"]) == 3


def test_speeds_uploaded_after_the_swim(board: Shell, tmp_path: Path) -> None:
    board.text("reference", "upload", "trapezoid:0.05,2,2")
    number = board.json("trial", "run")["number"]
    speeds = tmp_path / "speed.csv"
    speeds.write_text("beat,speed_m_s\n0,0.01\n1,\n2,\n3,0.03\n4,0.03\n5,0.01\n")
    assert board.json("trial", "speeds", str(number), str(speeds))["measured_beats"] == 4
    assert board.json("learn")["measured_beats"] == 4  # too few to judge the trial
    assert "could be judged" in board.fails("learn", "--restore-best")


def test_discard(board: Shell) -> None:
    board.text("reference", "upload", "trapezoid:0.05,1,1")
    board.text("trial", "run")
    assert board.json("trial", "discard")["pending_trial"] is None
    assert "waiting to be learned" in board.fails("learn")


def test_a_preset_is_asked_for_on_a_real_board(
    board: Shell, monkeypatch: pytest.MonkeyPatch
) -> None:
    board.text("params", "reset")
    monkeypatch.setitem(BOARD_KINDS, 2, "fish")
    assert "preset thesis was not set" in board.fails("params", "preset", "thesis")
    assert board.json("params", "get", "AMP_MAX_RAD")["value"] == 0.5
    questions: list[str] = []
    monkeypatch.setattr("sys.stdin", SimpleNamespace(isatty=lambda: True))
    monkeypatch.setattr("typer.confirm", lambda text, err: bool(questions.append(text)) or True)
    board.text("params", "preset", "thesis")
    assert "AMP_MAX_RAD from 0.5 to 0.785" in questions[0] and len(questions) == 1
    assert board.json("params", "get", "ROLLBACK_RATIO")["value"] == 0
    board.text("params", "reset")
    board.text("params", "preset", "thesis", "--yes")
    assert board.json("params", "get", "AMP_MAX_RAD")["value"] == pytest.approx(0.785398)
    assert len(questions) == 1
    board.text("params", "reset")


def test_params(board: Shell, tmp_path: Path) -> None:
    board.text("params", "set", "ILC_GAIN", "5")
    board.text("params", "save")
    board.text("params", "reset")
    assert board.json("params", "get", "ILC_GAIN")["value"] == 4
    board.text("params", "load")
    assert board.text("params", "get", "ILC_GAIN") == "ILC_GAIN = 5 rad s/m\n"
    board.text("params", "reset")
    assert board.json("params", "set", "ILC_KD", "-0.5")["value"] == -0.5
    board.text("params", "reset")
    rows = board.json("params", "list")["params"]
    assert {"name", "value", "default", "low", "high", "unit", "text"} == set(rows[0])
    assert "ILC_GAIN" in board.fails("params", "set", "ILC_GAIN", "-1")
    assert "no parameter 'NOSUCH'" in board.fails("params", "get", "NOSUCH")


def test_a_reference_that_does_not_fit(board: Shell, tmp_path: Path) -> None:
    assert "the tank has 3.00 m" in board.fails("reference", "upload", "trapezoid:0.1,1,40")
    assert "the board allows 300.0" in board.fails("reference", "check", "trapezoid:0.5,1,1")
    bad = tmp_path / "bad.csv"
    bad.write_text("t_s,v_m_s\n0,0\n1,nan\n")
    assert "row 3, column v_m_s" in board.fails("reference", "upload", str(bad))


def test_watch_prints_json_lines(board: Shell) -> None:
    lines = board.text("board", "watch", "--count", "3").splitlines()
    assert len(lines) == 3
    assert all("event" in json.loads(line) for line in lines)


def test_abort_and_clear_when_idle_do_nothing(board: Shell) -> None:
    assert board.json("stop")["state"] == "IDLE"
    assert board.json("board", "clear")["state"] == "IDLE"


def law_files(folder: Path, law: str) -> list[str]:
    (folder / "law.json").write_text(law)
    (folder / "u.csv").write_text("beat,amplitude_rad\n0,0.1\n1,2.0\n2,0.3\n")
    (folder / "e.csv").write_text("beat,error_m_s\n0,0.01\n1,-0.01\n2,\n")
    names = {"--config": "law.json", "--input": "u.csv", "--error": "e.csv"}
    return [word for key, name in names.items() for word in (key, str(folder / name))]


def test_law(alone: Shell, tmp_path: Path) -> None:
    words = law_files(tmp_path, '{"kp_rad_s_m": 4}')
    document = alone.json("sim", "law", *words)
    expected = np.array([0.14, np.pi / 4 - 0.04, 0.3])
    np.testing.assert_allclose(document["amplitude_rad"], expected, rtol=1e-6)
    assert document["report"]["measured_beats"] == 2
    lines = alone.text("sim", "law", *words).splitlines()
    assert lines[0] == "beat,amplitude_rad"
    assert [float(line.split(",")[1]) for line in lines[1:]] == document["amplitude_rad"]


def test_law_refuses(alone: Shell, tmp_path: Path) -> None:
    assert "unknown key gamma" in alone.fails("sim", "law", *law_files(tmp_path, '{"gamma": 4}'))
    words = law_files(tmp_path, "{}")
    (tmp_path / "u.csv").write_text("beat,amplitude_rad\n0,0.1\n2,0.2\n")
    assert "row 3, column beat" in alone.fails("sim", "law", *words)
    (tmp_path / "u.csv").write_text("beat,amplitude_rad\n0,x\n")
    assert "row 2, column amplitude_rad" in alone.fails("sim", "law", *words)
    (tmp_path / "u.csv").write_text("0,1\n")
    assert "no column beat" in alone.fails("sim", "law", *words)


def test_demo_prints_one_document(alone: Shell, tmp_path: Path) -> None:
    one = ("sim", "demo", "--law", "p", "--trials", "1", "--out", str(tmp_path))
    document = alone.json(*one, "--seed", "4")
    assert (document["seed"], len(document["trials"])) == (4, 2)
    text = alone.text(*one)
    assert "error bound 10.4 mm/s" in text
    assert text.splitlines()[-1] == f"report {tmp_path / 'report' / 'report.html'}"


def test_wrong_calls(alone: Shell) -> None:
    assert "No such command" in alone.fails("swim", status=2)
    assert "--help" in alone.fails("params", "set", "ILC_GAIN", status=2)
    assert alone.fails("sim", "demo", "--trials", "0", status=2)
    assert alone.fails("learn", "--dry-run", "--restore-best", status=2)
    assert "no plant pond" in alone.fails("sim", "demo", "--plant", "pond")
    assert "no value colour" in alone.fails("sim", "demo", "--set", "colour=1")
    assert "is no setting" in alone.fails("sim", "--set", "kappa")
    for word in ("plant", "self", "url"):
        assert f"no value {word}" in alone.fails("sim", "demo", "--set", f"{word}=1")
        assert f"no value {word}" in alone.fails("sim", "--set", f"{word}=1")
    assert "is no seed" in alone.fails("sim", "--set", "seed=1.5")
    assert "is no experiment" in alone.fails("experiment", "note", "/nonexistent", "x")


def test_nobody_there(capsys: pytest.CaptureFixture[str]) -> None:
    shell = Shell(capsys, "tcp:127.0.0.1:1")
    assert "tailbeat sim" in shell.fails("info")


def test_start_is_quick_because_nothing_heavy_is_imported() -> None:
    heavy = ["matplotlib", "scipy", "pyulog", "numpy", "pyarrow"]
    code = (
        "import sys; from tailbeat.app.cli import run; run(['--help']); "
        f"sys.exit(', '.join(m for m in {heavy} if m in sys.modules) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_no_command_loads_scipy_or_matplotlib_before_it_runs() -> None:
    heavy, studies = ["scipy", "matplotlib", "pyarrow"], ["sim thesis", "sim montecarlo"]
    code = (
        "import sys; from tailbeat.app.cli.app import COMMANDS; "
        "[one.load(name) for name, one in COMMANDS.items() "
        f"if not one.needs and name not in {studies}]"
        f"; sys.exit(', '.join(m for m in {heavy} if m in sys.modules) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_what_the_system_refuses_is_one_line(alone: Shell, tmp_path: Path) -> None:
    taken = tmp_path / "file"
    taken.write_text("x")
    assert str(taken) in alone.fails(
        "sim", "demo", "--law", "p", "--trials", "1", "--out", str(taken)
    )
    assert str(taken) in alone.fails("trial", "pull", "--into", str(taken))
    long = tmp_path / "long.csv"
    long.write_text("t_s,v_m_s\n" + "1" * 200_000)
    assert "cannot read" in alone.fails("reference", "check", str(long))


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_a_full_disk_behind_the_output() -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-c", "from tailbeat.app.cli import main; main()", "--version"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == 1
    assert done.stderr.startswith("tailbeat: cannot use the output")
    assert done.stderr.count("\n") == 1


def test_numbers_out_of_range(board: Shell) -> None:
    for words in (("learn",), ("trial", "pull"), ("trial", "discard")):
        board.fails(*words, "9" * 60, status=2)
        board.fails(*words, "0", status=2)
    board.fails("trial", "speeds", "9" * 12, "speed.csv", status=2)
    assert "there is no trial file" in board.fails("trial", "show", "\u00b2")


def test_a_seed_out_of_range(alone: Shell) -> None:
    assert "is no seed" in alone.fails("sim", "demo", "--seed", "9" * 30)


def test_camera_addresses(board: Shell) -> None:
    assert "has no port number" in board.fails("trial", "run", "--camera", "tcp:pond")
    assert "needs a calibration" in board.fails("trial", "run", "--camera", "pond")
    assert "no camera answers" in board.fails("trial", "run", "--camera", "tcp:127.0.0.1:1")


def test_a_pull_that_was_broken_off_does_not_disturb_the_next(board: Shell, tmp_path: Path) -> None:
    board.text("reference", "upload", "trapezoid:0.05,1,1")
    number = board.json("trial", "run")["number"]
    board.text("trial", "discard")
    words = ("experiment", "new", "--reference", "trapezoid:0.05,1,1", "--root", str(tmp_path))
    folder = Path(board.json(*words)["folder"])
    (folder / ".pulling").mkdir()
    (folder / ".pulling" / "9999.ulg.part").write_bytes(b"ULog")
    files = board.json("trial", "pull", str(number), "--into", str(folder))["files"]
    assert Path(files[0]).parent == folder / "raw"
    assert (folder / ".pulling" / "9999.ulg.part").exists()


ERRORS = {
    "usage": (["learn", "--dry-run", "--restore-best"], 2, "exclude each other", "Try: tailbeat "),
    "no command": (["params", "nothing"], 2, "No such command", "Try: tailbeat params --help"),
    "input": (["reference", "check", "none.csv"], 1, "none.csv", ""),
    "board": (["learn"], 1, "waiting to be learned", "tailbeat trial list"),
    "link": (["info"], 1, "nothing answers", "tailbeat sim"),
    "system": (["trial", "pull", "--into", "taken"], 1, "cannot use taken", "Check the path"),
}


@pytest.mark.parametrize("kind", ERRORS)
def test_with_json_an_error_is_a_document(
    board: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    words, status, message, remedy = ERRORS[kind]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "taken").write_text("x")
    url = "tcp:127.0.0.1:1" if kind == "link" else "the board"
    if kind == "link":
        monkeypatch.undo()
    more = [] if kind == "no command" else ["--connect", url]
    assert run([*words, *more]) == status
    plain, line = board.capsys.readouterr()
    assert plain == ""
    assert run([*words, *more, "--json"]) == status
    out, err = board.capsys.readouterr()
    assert err == line
    assert out.count("\n") == 1
    document = json.loads(out)
    assert set(document) == {"error"} and set(document["error"]) == {"message", "remedy"}
    assert message in document["error"]["message"]
    assert remedy in document["error"]["remedy"]


def test_what_was_computed_stands_beside_the_error(board: Shell) -> None:
    words = ("reference", "check", "trapezoid:0.5,1,1")
    assert run(board.line(*words, "--json")) == 1
    out, err = board.capsys.readouterr()
    document = json.loads(out)
    assert document["beats"] == 3 and document["problems"]
    assert document["error"]["message"] in err
    assert board.fails(*words) == err


def test_a_command_that_fails_at_once_forgets_json(board: Shell) -> None:
    assert run(["params", "get", "NOSUCH", "--json", "--connect", "the board"]) == 1
    board.capsys.readouterr()
    assert "NOSUCH" in board.fails("params", "get", "NOSUCH")
    # a value that looks like the option is none
    assert run(["trial", "discard", "--reason", "--json", "--connect", "the board"]) == 1
    assert board.capsys.readouterr().out == ""
