"""The include checker finds what it is there to find, in a made-up tree and in the real one."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
CHECKER = ROOT / "tools" / "check_includes.py"


def check(root: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(CHECKER), str(root)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def write(root: Path, path: str, text: str) -> None:
    (root / path).parent.mkdir(parents=True, exist_ok=True)
    (root / path).write_text(text)


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A small tree without a fault."""
    write(tmp_path, "firmware/base/crc.h", "")
    write(tmp_path, "firmware/gait/gait.c", '#include "base/crc.h"\n#include <stdint.h>\n')
    write(tmp_path, "firmware/store/store.c", '#include "lfs.h"\n#include "hal/flash.h"\n')
    write(tmp_path, "firmware/app/app.c", '#include "app.h"\n#include "link/link.h"\n')
    write(tmp_path, "firmware/app/app.h", "")
    write(tmp_path, "hal/include/hal/clock.h", '#include "hal/hal.h"\n')
    return tmp_path


def test_accepts_a_right_tree(tree: Path) -> None:
    done = check(tree)
    assert done.returncode == 0, done.stdout


def test_the_repository_is_right() -> None:
    done = check(ROOT)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize(
    ("path", "line"),
    [
        ("firmware/gait/bad.c", '#include "hal/clock.h"'),
        ("firmware/ilc/bad.c", '#include "store/store.h"'),
        ("firmware/speed/bad.h", '#include "link/link.h"'),
        ("firmware/supervisor/bad.c", '  #  include "app/app.h"'),
        ("firmware/base/bad.c", '#include "params/params.h"'),
        ("firmware/store/bad.c", '#include "hal/serial.h"'),
        ("firmware/store/bad.c", '#include "link/link.h"'),
        ("firmware/link/bad.c", '#include "app/app.h"'),
        ("firmware/app/bad.c", '#include "sim.h"'),
        ("firmware/app/bad.c", '#include "mock_hal.h"'),
        ("firmware/app/bad.c", '#include "../../hal/sam3x8e/uart.h"'),
        ("firmware/app/bad.c", '#include "../hal/sam3x8e/uart.h"'),
        ("hal/include/hal/bad.h", '#include "base/crc.h"'),
    ],
)
def test_catches_c(tree: Path, path: str, line: str) -> None:
    write(tree, path, f"{line}\n")
    done = check(tree)
    assert done.returncode == 1
    assert done.stdout.startswith(f"{path}: ")
    assert line.split('"')[1] in done.stdout


def test_a_new_folder_needs_a_rule(tree: Path) -> None:
    write(tree, "firmware/extra/new.c", "")
    done = check(tree)
    assert done.returncode == 1
    assert "no rule" in done.stdout


@pytest.mark.parametrize("name", ["hal_servo_pulse_isr", "hal_guard_open_isr", "monitor_tick_isr"])
def test_only_the_tick_reaches_the_servo(tree: Path, name: str) -> None:
    write(tree, "firmware/app/control.c", f"void tick(void) {{ {name}(0); }}\n")
    assert check(tree).returncode == 0
    write(tree, "firmware/app/app.c", f"void other(void) {{ {name}(0); }}\n")
    done = check(tree)
    assert done.returncode == 1
    assert f"only control.c may call {name}()" in done.stdout
