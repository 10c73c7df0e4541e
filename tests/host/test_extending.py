"""docs/how-to/extend.md, followed in a copy of the repository: what it adds must build and
work, in as many files as the page says."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from tailbeat.link import _dialect

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "how-to" / "extend.md"
BLOCK = re.compile(
    r"^<!-- (?P<how>new|below|above) (?P<file>[^\s:]+)(?:: (?P<anchor>.+?))? -->\n\n?"
    r"```\w*\n(?P<text>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
SECTION = re.compile(r"^## (.+)$", re.MULTILINE)
ROW = re.compile(r"^\| ([^|]+?) \| (\d+) \|", re.MULTILINE)


@dataclass(frozen=True)
class Edit:
    """One marked block of the page: lines that go into a file, and where."""

    how: str
    file: str
    anchor: str
    text: str

    def apply(self, root: Path) -> None:
        """Writes the lines; a place must be named by exactly one line of the file."""
        path = root / self.file
        if self.how == "new":
            assert not path.exists()
            path.write_text(self.text)
            return
        lines = path.read_text().splitlines(keepends=True)
        (at,) = [i for i, line in enumerate(lines) if self.anchor in line]
        lines.insert(at + (self.how == "below"), self.text)
        path.write_text("".join(lines))


def sections() -> dict[str, list[Edit]]:
    """Title of a section of the page -> its edits."""
    parts = SECTION.split(PAGE.read_text())[1:]
    return {
        title: [Edit(**m.groupdict(default="")) for m in BLOCK.finditer(text)]
        for title, text in zip(parts[::2], parts[1::2], strict=True)
    }


@pytest.fixture(scope="module")
def extended(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The repository with everything added that the page adds, and its native library."""
    root = tmp_path_factory.mktemp("extended")
    listed = subprocess.run(
        ["git", "-C", str(ROOT), "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        capture_output=True,
        check=True,
    )
    for name in listed.stdout.decode().split("\0"):
        if name and (ROOT / name).is_file() and not name.startswith("tests/data"):
            (root / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, root / name)
    for edits in sections().values():
        for edit in edits:
            edit.apply(root)
    build(root)
    return root


def build(root: Path) -> None:
    """The native library of the copy, beside its sources: where the installed package has it."""
    configure = ["cmake", "-S", ".", "-B", "build/native", "-G", "Ninja", "--log-level=WARNING"]
    options = ["-DCMAKE_BUILD_TYPE=None", "-DTAILBEAT_TESTS=OFF"]  # compiling takes longest
    options += [f"-DPython_EXECUTABLE={sys.executable}", f"-DTAILBEAT_FETCHED_DIR={ROOT / 'build'}"]
    for command in ([*configure, *options], ["ninja", "-C", "build/native", "tailbeat_native"]):
        subprocess.run(command, cwd=root, check=True, stdout=subprocess.DEVNULL)
    core = root / "host" / "tailbeat" / "core"
    for name in ("libtailbeat_native.so", "_native_types.py"):
        shutil.copy(next((root / "build/native").rglob(name)), core)
    shutil.copy(str(_dialect.__file__), root / "host" / "tailbeat" / "link")


def python(root: Path, code: str, *words: str) -> str:
    """What a program prints that has the copy's package."""
    command = [sys.executable, "-c", code, *words]
    env = {**os.environ, "PYTHONPATH": str(root / "host")}
    done = subprocess.run(command, cwd=root, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def run(root: Path, *words: str) -> str:
    """A command of the copy's tool."""
    return python(root, "from tailbeat.app.cli import main; main()", *words)


def test_a_change_touches_as_many_files_as_the_page_says() -> None:
    promised = {title: int(files) for title, files in ROW.findall(PAGE.read_text())}
    for title, edits in sections().items():
        if edits:
            files = {Path(edit.file).with_suffix("") for edit in edits}
            assert len(files) == promised[title], title


def test_a_parameter(extended: Path) -> None:
    listed = json.loads(run(extended, "params", "list", "--connect", "sim", "--json"))
    assert "SETTLE_MORE_S" in json.dumps(listed)


def test_a_fault(extended: Path) -> None:
    code = (
        "from tailbeat.core.faults import fault_info\n"
        "from tailbeat.core.native import lib\n"
        "print(fault_info(lib.FAULT_ROLLED_OVER).meaning)"
    )
    assert python(extended, code) == "the fish rolled over\n"


def test_a_figure(extended: Path, tmp_path: Path) -> None:
    run(extended, "sim", "demo", "--law", "p", "--trials", "1", "--out", str(tmp_path / "series"))
    run(extended, "report", str(tmp_path / "series"))
    page = (tmp_path / "series" / "report" / "report.html").read_text()
    assert "Measured beats of every trial, 1 experiments." in page


def test_a_servo(extended: Path, tmp_path: Path) -> None:
    """On the mock board; and the code of the SAM3X8E compiles with it."""
    (tmp_path / "rudder.c").write_text(RUDDER)
    folders = [f"-I{extended / name}" for name in ("firmware", "hal/include", "hal/mock")]
    modules = ["trial/control.c", "blink/blink.c", "gait/gait.c", "gait/servo.c", "base/real.c"]
    modules += ["supervisor/stop_rules.c", "supervisor/battery.c", "monitor/monitor.c"]
    modules += ["params/params.c", "base/crc.c", "store/records.c", "ilc/judge.c"]
    modules += ["ilc/number.c", "speed/source.c"]
    sources = ["rudder.c", f"{extended}/hal/mock/mock_hal.c"]
    sources += [f"{extended}/firmware/{name}" for name in modules]
    options = ["-std=c11", "-Wall", "-Werror", *folders]
    subprocess.run(["cc", *options, *sources, "-o", "rudder", "-lm"], cwd=tmp_path, check=True)
    done = subprocess.run(["./rudder"], cwd=tmp_path, check=True, capture_output=True, text=True)
    assert done.stdout.split() == ["0", "4844", "0"]
    chip = ["arm-none-eabi-gcc", "-mcpu=cortex-m3", "-mthumb", *options, "-fsyntax-only"]
    board = extended / "hal" / "sam3x8e"
    core = board.parent / "cortex_m3"
    subprocess.run([*chip, f"-I{board}", f"-I{core}", str(board / "servo.c")], check=True)


RUDDER = """
#include "trial/control.h"
#include "mock_hal.h"
#include "store/records.h"
#include <stdio.h>

static hal_t hal;
static control_t control;
static const float amplitude_rad[1] = {0.3f};

static void tick_and_print(int ticks) {
    for (int i = 0; i < ticks; i++) {
        hal.now_us += 20000;
        control_tick_isr(&control, &hal);
    }
    printf("%u ", (unsigned)hal.pulse_ticks[HAL_SERVO_RUDDER]);
}

int main(void) {
    mock_hal_init(&hal);
    control_init(&control);
    tick_and_print(1);
    static uint8_t record[RECORD_MAX_BYTES];
    params_t params;
    params_reset(&params);
    control_offer(&control, record, record_encode_params(&params, record));
    const control_orders_t orders = {
        .swim = true, .trial = 1, .beats = 1, .amplitude_rad = amplitude_rad, .rudder_rad = 0.2f,
        .gait = {.servo = {.centre_us = 1500.0f, .us_per_rad = 573.0f, .min_us = 900.0f,
                           .max_us = 2100.0f, .direction = 1.0f},
                 .frames_per_beat = 50, .coast_frames = 25}};
    control_order(&control, &hal, &orders);
    tick_and_print(10);
    tick_and_print(80);
    return 0;
}
"""


def test_a_preflight_check(extended: Path) -> None:
    code = (
        "from tailbeat import Fish\n"
        "from tailbeat.session.preflight import CHECKS, Preflight\n"
        "from tailbeat.session.preflight_step import NotReady, PreflightLimits\n"
        "(check,) = [one for one in CHECKS if one.name == 'tank']\n"
        "class Operator:\n"
        "    tell = staticmethod(lambda event: print(event.step, event.text, event.ok))\n"
        "with Fish.connect('sim:tank') as fish:\n"
        "    at = Preflight(fish, PreflightLimits(), None, Operator())\n"
        "    check.function(at, at.step(check))\n"
        "    fish.params.set('TANK_LEN_M', 0.0)\n"
        "    try:\n"
        "        check.function(at, at.step(check))\n"
        "    except NotReady as error:\n"
        "        print(error.remedy)\n"
    )
    remedy = "Set TANK_LEN_M to the length of the tank in m, then begin again."
    said = ["tank the length of the tank is set True", "tank TANK_LEN_M is 0 False", remedy]
    assert python(extended, code).splitlines() == said


def test_a_guard(extended: Path) -> None:
    code = (
        "from tailbeat.link.messages import BeatEvent\n"
        "from tailbeat.session.guards import GuardedTrial, guards_of\n"
        "params = dict(TANK_LEN_M=0, FISH_LEN_M=0.36, MDL_KAPPA=10, SPD_LATE_S=1, SPD_GAP_S=1)\n"
        "guard = guards_of(GuardedTrial(params, []))\n"
        "for speed in (0.1, 0.4):\n"
        "    print(guard(BeatEvent(1, 0, 0.3, 0.1, speed, 0.01, 9, False, False)))\n"
    )
    assert python(extended, code) == "None\nfaster than 0.3 m/s\n"


def test_a_command(extended: Path) -> None:
    said = json.loads(run(extended, "reference", "distance", "thesis", "--json"))
    assert said["distance_m"] == pytest.approx(2.20, abs=0.01)


def test_a_verb(extended: Path) -> None:
    code = (
        "from tailbeat import Fish\n"
        "from tailbeat.sim.world import VERBS\n"
        "with Fish.connect('sim:tank') as fish: fish.sim.world.freeze()\n"
        "print(VERBS['freeze'].does)"
    )
    assert python(extended, code) == "the fish loses all speed at once\n"
