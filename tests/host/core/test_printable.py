"""Nothing from outside steers the terminal: hostile text at every source, looked for in what is
printed."""

from __future__ import annotations

import math
import re
import unicodedata
from datetime import datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import tailbeat
from tailbeat.app.cli import run
from tailbeat.app.cli._terminal import Output, echo, present, table, write_json
from tailbeat.app.web.state import PageState, logged
from tailbeat.board.fish import Fish
from tailbeat.core.printable import mm, printable, printable_lines
from tailbeat.experiment.folder import Experiment
from tailbeat.link import _dialect as mavlink
from tailbeat.link.messages import text_event
from tailbeat.link.params import Parameters
from tailbeat.sim.board import SimBoard, SimTransport

HOSTILE = "\x1b]0;x\x07\x1b[2J\r\x9b31m\u202eevil\u2066\u200f\u2028\x00\x7f\ud800"
SAFE = r"\x1b]0;x\x07\x1b[2J\r\x9b31m\u202eevil\u2066\u200f\u2028\x00\x7f\ud800"  # one line, ASCII


def require_safe(text: str) -> None:
    assert "evil" in text
    bad = [c for c in text if unicodedata.category(c) in ("Cc", "Cf", "Cs", "Zl", "Zp")]
    assert set(bad) <= {"\n"}, bad


def test_what_is_unsafe_becomes_visible() -> None:
    assert printable(HOSTILE) == SAFE
    assert printable("a\nb\tc") == r"a\nb\tc"
    assert printable_lines("a\nb\tc") == "a\nb\\tc"
    for harmless in ("", "79.1 mm/s ± 0.2 °, ∞ ✓ 魚", "ä\u0308 \U0001f41f"):
        assert printable(harmless) == harmless


def test_text_of_the_board() -> None:
    """STATUSTEXT, the motion sensor's model, a parameter's name: as frames of the dialect."""
    evil = "\x1b[2J\u202eevil\n"
    said = text_event(mavlink.MAVLink_statustext_message(6, evil.encode()))["text"]
    with Fish(SimTransport(SimBoard("tank"))) as fish:
        real = fish.link.request

        def request(*given: Any, **more: Any) -> Any:
            answer = real(*given, **more)
            if answer.get_type() == "TAILBEAT_IMU_INFO":
                answer.model = evil
            return answer

        fish.link.request = request  # type: ignore[method-assign]
        model = fish.imu_info().model
    assert model is not None
    require_safe(model)
    said_of_it = SimpleNamespace(param_id=evil, param_value=1.0)
    name = Parameters(fish.link)._parameter(said_of_it).name  # type: ignore[arg-type]
    require_safe(name)
    require_safe(said)
    assert "\n" not in model + name + said


def test_names_and_notes_of_experiments(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    evil = HOSTILE.replace("\ud800", "")
    made = Experiment.new(Path("experiments"), evil, evil, evil, datetime(2026, 5, 4))
    made.note(evil)
    made.write_settings({"operator": evil, "configuration": evil, "conditions": {evil: evil}})
    for command in (["list"], ["show", str(made.folder)], ["note", str(made.folder), evil]):
        run(["experiment", *command])
    done = capsys.readouterr()
    require_safe(done.out + done.err)


@pytest.mark.parametrize("cell", ["t_s,v_m_s\n0,\x1b[2J\u202eevil\n", "t_s,\x1b[2Jevil\n0,0\n"])
def test_cells_and_names_of_files(
    cell: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "\x1b[2Jevil\u202e.csv"
    path.write_text(cell)
    assert run(["reference", "upload", str(path), "--connect", "sim"]) == 1
    require_safe(capsys.readouterr().err)


def test_lines_tables_and_the_page(capsys: pytest.CaptureFixture[str]) -> None:
    echo(HOSTILE)
    present(Output({}, table(["name"], [[HOSTILE + "\n"]])))
    write_json({"name": HOSTILE})
    printed = capsys.readouterr().out
    require_safe(printed)
    assert printed.count("\n") == 6  # the cell's own line end is none: 1 + 2 + 3
    (line,) = logged(PageState(), HOSTILE, "12:00:00").log
    require_safe(line)


def test_commands_print_through_one_function() -> None:
    """``echo`` and ``write_json``; another way out needs a reason and a line here."""
    own = {"_terminal.py": 3, "key.py": 1}
    ways = re.compile(r"typer\.echo\(|std(?:out|err)\.write\(|(?<![.\w])print\(")
    found = {}
    for path in (Path(tailbeat.__file__).parent / "app" / "cli").glob("*.py"):
        if count := len(ways.findall(path.read_text(encoding="utf-8"))):
            found[path.name] = count
    assert found == own


def test_speeds_in_mm_s() -> None:
    assert mm(0.01234) == "12.3"
    assert [mm(None), mm(math.nan), mm(math.inf, "none")] == ["-", "-", "none"]
