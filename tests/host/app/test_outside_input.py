"""What boards, files and users give that nobody expects: one line that says what to do."""

from __future__ import annotations

import builtins
import csv
import math
import subprocess
import sys
import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import tailbeat
from tailbeat.app import cli
from tailbeat.app.cli import run
from tailbeat.board import memory
from tailbeat.board.connect import open_transport
from tailbeat.board.fish import Fish
from tailbeat.core.csv import read_speeds
from tailbeat.core.errors import InputError, Refused, TransferError
from tailbeat.core.reference import from_csv, from_text
from tailbeat.experiment.current import make
from tailbeat.experiment.export import export
from tailbeat.link.ftp.client import RemoteFile, _remote_file
from tailbeat.report.paper import write_report
from tailbeat.sim.board import SimBoard, SimTransport
from tailbeat.sim.server import parse_listen

from ..swum_experiment import REFERENCE, swim_one

SITE = Path(tailbeat.__file__).parent.parent


@pytest.fixture
def fish() -> Any:
    with Fish(SimTransport(SimBoard("tank"))) as connected:
        yield connected


# What a board says.


def test_names_that_are_no_numbers(fish: Fish, monkeypatch: pytest.MonkeyPatch) -> None:
    """``²`` is a digit, and no number."""
    names = ["²", "٣", "", "x", "0002"]
    files = [RemoteFile(f"{name}.ulg", 9, False) for name in names]
    monkeypatch.setattr(fish.ftp, "list", lambda _: files)
    assert [trial.number for trial in fish.trials()] == [2]
    assert _remote_file("Fa\t²".encode()) == RemoteFile("a", 0, False)


def test_a_board_that_claims_65535_parameters(fish: Fish, monkeypatch: pytest.MonkeyPatch) -> None:
    def recv(*_: Any) -> Any:
        return SimpleNamespace(param_count=65535, param_index=3, param_id="X", param_value=0.0)

    monkeypatch.setattr(fish.link, "recv", recv)
    with pytest.raises(TransferError, match="claims to have 65535 parameters"):
        fish.params.list()


def test_a_board_that_repeats_one_parameter(fish: Fish, monkeypatch: pytest.MonkeyPatch) -> None:
    """It never falls silent."""
    there, real, rounds = len(fish.params.list()), fish.link.recv, []

    def recv(kind: Any, *given: Any) -> Any:
        if len(rounds) < 2000:
            rounds.append(kind)
            return SimpleNamespace(param_count=80, param_index=3, param_id="X", param_value=0.0)
        return real(kind, *given)

    monkeypatch.setattr(fish.link, "recv", recv)
    assert len(fish.params.list()) == there
    assert len(rounds) == 2000


@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0, 256.0])
def test_update_counts_that_are_none(
    value: float, fish: Fish, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fish, "_steady", lambda _: (SimpleNamespace(), [1.0, value]))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(TransferError, match="update counts"):
            fish.visits()
    assert memory._VISITS_MAX == 255


def test_a_parameter_name_gets_a_guess(fish: Fish) -> None:
    for call in (fish.params.get, lambda name: fish.params.set(name, 1.0)):
        with pytest.raises(Refused, match=r"no parameter 'ILC_GIAN'. Did you mean ILC_GAIN"):
            call("ILC_GIAN")
        with pytest.raises(Refused, match=r"no parameter 'ZZZZ'. Print all names"):
            call("ZZZZ")
        with pytest.raises(Refused, match=r"Did you mean ILC_LEAD"):
            call("ILC_LEAD_OF_THE_BOARD"[:10])
        with pytest.raises(Refused, match=r"no parameter 'ILC_GAIN_OF_THE_FISH'"):
            call("ILC_GAIN_OF_THE_FISH")


# Ctrl-C.


def test_ctrl_c_while_the_program_starts(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    real = builtins.__import__

    def interrupted(name: str, *given: Any) -> Any:
        if name == "tailbeat.app.cli.app":
            raise KeyboardInterrupt
        return real(name, *given)

    monkeypatch.setattr(builtins, "__import__", interrupted)
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 130
    assert capsys.readouterr() == ("", "")


def test_nothing_is_loaded_before_ctrl_c_is_caught() -> None:
    """Python itself starts in 10 ms; what is loaded after that, and before ``main``, adds to the
    time in which Ctrl-C ends in a traceback."""
    look = (
        f"import os, sys; sys.path.append({str(SITE)!r}); had = set(sys.modules);"
        " import tailbeat.app.cli; print(*set(sys.modules) - had)"
    )
    command = [sys.executable, "-I", "-S", "-c", look]
    told = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert set(told.split()) == {"__future__", "tailbeat", "tailbeat.app", "tailbeat.app.cli"}


# Files.

COMMAS = "commas between columns and decimal points"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("t_s;v_m_s\n0,0;0,00\n1,0;0,05\n", "has semicolons between its columns. Save it with"),
        ("t_s\tv_m_s\n0\t0\n", "has tabs between its columns"),
        ("t_s,v_m_s\n0,0\n0,5,0,07\n", "row 3 has 4 cells, the header has 2"),
    ],
)
def test_spreadsheets_with_decimal_commas(content: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text(content)
    for read in (from_csv, lambda path: read_speeds(path, 3, 1.0)):
        with pytest.raises(InputError, match=words) as error:
            read(path)
        assert COMMAS in error.value.remedy


def test_further_columns_are_ignored_and_empty_cells_allowed(tmp_path: Path) -> None:
    plain, more = tmp_path / "a.csv", tmp_path / "b.csv"
    plain.write_text("t_s,v_m_s\n0,0.05\n4,0.05\n")
    more.write_text("t_s,note,v_m_s\n0,begin,0.05,,\n4,=1+1,0.05\n\n")
    assert from_csv(more).record() == from_csv(plain).record()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["reference", "upload", ""], "the name of the reference is empty. Use thesis"),
        (["reference", "upload", "."], "'.' is a folder, no reference. Name a CSV file"),
        (["trial", "show", "nope.ulg"], "there is no trial file nope.ulg. Check the path"),
        (["info", "--connect", "tcp:127.0.0.1:99999"], "the port 99999 of tcp:127.0.0.1:99999 is"),
        (["info", "--connect", "tcp:127.0.0.1:²"], "has no port number"),
    ],
)
def test_wrong_words_at_the_terminal(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(arguments) == 1
    told = capsys.readouterr().err
    assert words in told
    assert told.count("\n") == 1


@pytest.mark.parametrize("port", ["0", "65536", "9" * 5000])
def test_ports_out_of_range(port: str) -> None:
    with pytest.raises(InputError, match=r"out of range\. Give a port from 1 to 65535"):
        open_transport(f"tcp:127.0.0.1:{port}")
    if port != "0":
        with pytest.raises(InputError, match="no place to listen"):
            parse_listen(f"tcp:127.0.0.1:{port}")
    with pytest.raises(InputError, match="no place to listen"):
        parse_listen("tcp:127.0.0.1:²")
    with pytest.raises(InputError, match="empty"):
        from_text(" ")


# Exports and reports.


EVIL = "=HYPERLINK(1)"


@pytest.fixture(scope="module")
def experiment(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Two trials, one discarded for a reason that is a formula."""
    with Fish.connect("sim:tank?seed=1") as fish:
        fish.upload_reference(REFERENCE)
        made = make(fish, tmp_path_factory.mktemp("evil"), REFERENCE, "carangi", {})
        swim_one(fish, made, "keep")
        swim_one(fish, made, "discard", EVIL)
    return made


def test_an_export_holds_no_formula(experiment: Any, tmp_path: Path) -> None:
    cells = []
    for path in export(experiment, ["csv"], tmp_path):
        with path.open(newline="") as file:
            cells += [cell for row in csv.reader(file) for cell in row]
    assert "'" + EVIL in cells

    def is_number(cell: str) -> bool:
        try:
            return bool(float(cell)) or True
        except ValueError:
            return False

    assert [cell for cell in cells if cell[:1] in "=+-@" and cell and not is_number(cell)] == []


def test_links_out_of_the_folder_are_not_followed(experiment: Any, tmp_path: Path) -> None:
    for name, write in (
        ("report", lambda: write_report(experiment)),
        ("export", lambda: export(experiment, ["csv"])),
    ):
        link = experiment.folder / name
        link.symlink_to(tmp_path)
        with pytest.raises(InputError, match=rf"{name} is a link to .*, outside the experiment"):
            write()
        link.unlink()
    (experiment.folder / "report").mkdir()
    (experiment.folder / "report" / "tables").symlink_to(tmp_path)
    with pytest.raises(InputError, match="tables is a link"):
        write_report(experiment, paper=True)
    assert list(tmp_path.iterdir()) == []
