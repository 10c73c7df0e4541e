"""The sessions of README.md and of the first tutorial, executed as they are written: the last
input must reach the error bound. And one whose amplitude limit is too low for the reference."""

from __future__ import annotations

import json
import random
import re
import shlex
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tailbeat.app.cli import run
from tailbeat.app.web.worker import Worker
from tailbeat.board.fish import Fish
from tailbeat.core import reference
from tailbeat.core.trial_file import Trial, read_trial
from tailbeat.learning.error_bound import error_bound
from tailbeat.learning.error_bound_solve import plant_beats, plant_config
from tailbeat.sim.board import SimBoard, SimTransport

from ..guided_page import start_on_page

ROOT = Path(__file__).parents[3]
SEEDS = random.Random("documented sessions").sample(range(1, 1_000_000), 20)
FEW = SEEDS[:2]
ENOUGH = 18  # of 20
ANY_RAD = 1.0471976  # the servo's range
REFERENCE = reference.thesis()
FACTOR, MORE_M_S = 1.10, 0.001
NOT_TAILBEAT = (". .venv/bin/activate",)


def block(page: str, heading: str, language: str = "sh") -> str:
    """The first code block below a heading."""
    text = (ROOT / page).read_text(encoding="utf-8")
    section = re.split(r"^## ", text, flags=re.MULTILINE)
    (found,) = [part for part in section if part.startswith(heading + "\n")]
    match = re.search(rf"^```{language}\n(.*?)^```$", found, re.MULTILINE | re.DOTALL)
    assert match is not None, heading
    return match[1]


def commands(text: str) -> list[list[str]]:
    """Its lines as words, without comments."""
    words = [shlex.split(line, comments=True) for line in text.splitlines()]
    return [one for one in words if one and shlex.join(one) not in NOT_TAILBEAT]


@cache
def bound_m_s() -> float:
    """The smallest max|e| of any input on the simulated fish, without noise."""
    return error_bound(plant_config("tank", {}), REFERENCE, ANY_RAD).minimax_m_s


def noise_free_m_s(trial: Trial) -> float:
    """max|e| of a trial's input, without noise."""
    speed = plant_beats(
        plant_config("tank", {}), trial.beats.applied_rad.astype(np.float64), trial.beat_s
    )
    return float(np.abs(trial.beats.reference_m_s - speed).max())


def judged(name: str, seed: int, trial: Trial) -> bool:
    """Whether the input reaches the error bound; prints it."""
    error, most = noise_free_m_s(trial), FACTOR * bound_m_s() + MORE_M_S
    words = f"{error * 1e3:.1f} mm/s, bound {bound_m_s() * 1e3:.1f}, at most {most * 1e3:.1f}"
    print(f"{name}, seed {seed}: trial {trial.number}: {words}")
    return error <= most


class Terminal:
    """Executes commands against a simulated board; what they printed is in ``out``."""

    def __init__(
        self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], folder: Path
    ) -> None:
        self._monkeypatch, self.capsys, self._folder = monkeypatch, capsys, folder
        self.out = ""

    def begin(self, seed: int) -> None:
        """An empty folder, and a trial library of its own."""
        self.seed, self.folder, self.out = seed, self._folder / str(seed), ""
        self.folder.mkdir()
        self._monkeypatch.chdir(self.folder)
        self._monkeypatch.setenv("TAILBEAT_LOGBOOK", str(self.folder / "library"))

    def says(self, *words: str) -> str:
        """Executes one command; what it printed."""
        program, *rest = words
        assert program == "tailbeat"
        if rest == ["sim", "&"]:
            board = SimBoard("tank", seed=self.seed)
            self._monkeypatch.setattr(
                "tailbeat.board.fish.open_transport", lambda _: SimTransport(board)
            )
            return ""
        status = run(rest)
        printed = "".join(self.capsys.readouterr())
        assert status == 0, f"seed {self.seed}: {printed}"
        self.out += printed
        return printed

    def last(self) -> Trial:
        """The newest trial of the experiments."""
        files = (self.folder / "experiments").glob("*/raw/*.ulg")
        return read_trial(max(files, key=lambda path: path.name))


@pytest.fixture
def terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> Terminal:
    return Terminal(monkeypatch, capsys, tmp_path)


@pytest.fixture
def python(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[int], Trial]]:
    """Executes the Python session of a seed; its last trial."""
    text = block("docs/tutorial/first-trial.md", "8. Use Python", "python")

    def execute(seed: int) -> Trial:
        monkeypatch.setattr("tailbeat.sim.board.DEFAULT_SEED", seed)
        names: dict[str, object] = {}
        exec(compile(text, "getting-started.md", "exec"), names)
        fish = names["fish"]
        assert isinstance(fish, Fish) and isinstance(fish.sim, SimBoard) and fish.sim.seed == seed
        with Fish(SimTransport(fish.sim)) as again:
            return read_trial(again.pull_trial(again.trials()[-1].number, Path.cwd()))

    yield execute


def by_readme(terminal: Terminal, seed: int) -> bool:
    terminal.begin(seed)
    for words in commands(block("README.md", "A session by hand")):
        terminal.says(*words)
    assert "saturated" not in terminal.out and "ended (converged)" in terminal.out
    with terminal.capsys.disabled():  # the next command's output is read, and this with it
        return judged("README", seed, terminal.last())


@pytest.mark.parametrize("seed", FEW)
def test_the_session_of_the_readme(terminal: Terminal, seed: int) -> None:
    assert by_readme(terminal, seed)


@pytest.mark.parametrize("seed", FEW)
def test_the_session_in_python(
    python: Callable[[int], Trial], seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert judged("getting-started", seed, python(seed))


def by_getting_started(terminal: Terminal, seed: int) -> bool:
    """Its reference, its parameters and its trials, decided as it says."""
    terminal.begin(seed)
    terminal.says("tailbeat", "sim", "&")
    page = "docs/tutorial/first-trial.md"
    for heading in ("3. Upload a reference", "4. Set the law", "5. Run trials"):
        for words in commands(block(page, heading)):
            then = ("--then", "keep") if words[1:3] == ["trial", "run"] else ()
            terminal.says(*words, *then)
    with terminal.capsys.disabled():
        return judged("getting-started", seed, terminal.last())


def by_start(terminal: Terminal, seed: int) -> bool:
    """The two words of the README, with the questions answered."""
    terminal.begin(seed)
    terminal.says("tailbeat", "sim", "&")
    printed = terminal.says("tailbeat", "start", "--yes")
    assert "saturated" not in printed and "ended (converged)" in printed
    with terminal.capsys.disabled():
        return judged("start", seed, terminal.last())


def by_page(terminal: Terminal, seed: int) -> bool:
    """START, yes to all questions, the number typed, every trial kept."""
    terminal.begin(seed)
    board = SimBoard("tank", seed=seed)
    worker = Worker(lambda: Fish(SimTransport(board)), Path("experiments"), look_s=0.005)
    worker.start()
    try:
        worker.screen.wait(lambda now: now.phase == "idle")
        now, _ = start_on_page(worker, "converged", "new")
    finally:
        worker.close()
    assert now.problem == "" and now.guide[-1].done
    with terminal.capsys.disabled():
        return judged("page", seed, terminal.last())


def by_notebook(terminal: Terminal, seed: int) -> bool:
    """Its first cells, up to the sixth trial."""
    terminal.begin(seed)
    path = ROOT / "docs" / "reference" / "fish-api.ipynb"
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    names: dict[str, Any] = {}
    for cell in cells:
        text = "".join(cell["source"])
        if cell["cell_type"] == "code":
            exec(compile(text.replace("seed=1", f"seed={seed}"), "notebook", "exec"), names)
        if "reports.append" in text:
            break
    fish = names["fish"]
    trial = read_trial(fish.pull_trial(names["outcomes"][-1].number, Path.cwd()))
    with terminal.capsys.disabled():
        return judged("notebook", seed, trial)


WAYS = (by_readme, by_getting_started, by_start, by_page, by_notebook)


@pytest.mark.soak
@pytest.mark.parametrize("way", WAYS)
def test_a_first_run_on_20_seeds(way: Callable[[Terminal, int], bool], terminal: Terminal) -> None:
    good = [way(terminal, seed) for seed in SEEDS]
    assert sum(good) >= ENOUGH


@pytest.mark.soak
def test_the_session_in_python_on_20_seeds(
    python: Callable[[int], Trial], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    good = [judged("Python", seed, python(seed)) for seed in SEEDS]
    assert sum(good) >= ENOUGH


def test_with_too_low_a_limit_the_session_says_so_and_how_to_go_on(terminal: Terminal) -> None:
    seed = SEEDS[2]
    terminal.begin(seed)
    for words in commands(block("README.md", "A session by hand")):
        if "AMP_MAX_RAD" not in words:
            terminal.says(*words)
    terminal.says("tailbeat", "progress")
    assert "ended (saturated): " in terminal.out
    words = r"\d\d of 40 beats at the limit 0\.50 rad; the reference needs about 0\.[67]\d"
    assert re.search(words, terminal.out)
    for line in terminal.out.splitlines():
        assert "converged" not in line or "saturated" in line, line
        assert "ILC_DECR_RATE" not in line, line
    check = terminal.says("tailbeat", "reference", "check", "thesis")
    assert "fits" in check and "saturation expected: 2" in check
    remedy = re.findall(r"tailbeat params set AMP_MAX_RAD 0\.\d\d", terminal.out)[-1]
    slower = re.findall(r"tailbeat reference upload thesis:\S+ --warm-start board", terminal.out)[
        -1
    ]
    terminal.says(*remedy.split())
    terminal.says("tailbeat", "trial", "run", "--until", "converged")
    assert judged(f"after {remedy}", seed, terminal.last())
    terminal.says("tailbeat", "params", "set", "AMP_MAX_RAD", "0.5")
    terminal.says(*slower.split())
    assert "saturated" not in terminal.says("tailbeat", "trial", "run", "--until", "4")
