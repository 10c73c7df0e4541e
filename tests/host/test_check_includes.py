"""The checker finds forbidden includes and circles, in a made-up tree and in the real one."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
CHECKER = ROOT / "tools" / "check_includes.py"


def check(root: Path, *options: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(CHECKER), str(root), *options]
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
    write(tmp_path, "hal/host/board.c", '#include "common/byte_ring.h"\n')
    write(tmp_path, "sim/fish/tail.c", '#include "water/tail_beat.h"\n')
    write(tmp_path, "sim/world.c", '#include "fish/tail.h"\n')
    return tmp_path


def check_tree(tree: Path) -> subprocess.CompletedProcess[str]:
    """No folder of a made-up tree may have circles."""
    return check(tree, "--circles-left")


def test_accepts_a_right_tree(tree: Path) -> None:
    done = check_tree(tree)
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
        ("hal/host/bad.c", '#include "world.h"'),
        ("hal/host/bad.c", '#include "water/plant.h"'),
        ("sim/common/bad.h", '#include "water/plant.h"'),
        ("sim/water/bad.h", '#include "fish/fish.h"'),
        ("sim/fish/bad.h", '#include "sensor/vn100.h"'),
        ("sim/fish/bad.h", '#include "world.h"'),
        ("sim/sensor/bad.c", '#include "host/line.h"'),
        ("sim/camera/bad.c", '#include "sensor/vn100.h"'),
        ("sim/bad.c", '#include "batch/batch.h"'),
        ("sim/batch/bad.c", '#include "world.h"'),
    ],
)
def test_catches_c(tree: Path, path: str, line: str) -> None:
    write(tree, path, f"{line}\n")
    done = check_tree(tree)
    assert done.returncode == 1
    assert done.stdout.startswith(f"{path}: ")
    assert line.split('"')[1] in done.stdout


@pytest.mark.parametrize("folder", ["firmware/extra", "hal/extra", "sim/extra"])
def test_a_new_folder_needs_a_rule(tree: Path, folder: str) -> None:
    write(tree, f"{folder}/new.c", "")
    done = check_tree(tree)
    assert done.returncode == 1
    assert "no rule" in done.stdout


# Files of firmware/link, and the circle they form.
CIRCLES = {
    "headers": (
        {
            "a.h": '#include "link/b.h"\n',
            "b.h": '#include "b_more.h"\n',
            "b_more.h": '#include "a.h"\n',
        },
        "a.h -> b.h (by including link/b.h) -> b_more.h (by including b_more.h)"
        " -> a.h (by including a.h)",
    ),
    "calls behind a shared header": (
        {
            "shared.h": "void a_go(int *x);\nint *b_find(int x);\n",
            "a.c": '#include "shared.h"\nvoid a_go(int *x) { *x = *b_find(*x); }\n',
            "b.c": '#include "shared.h"\nint *b_find(int x) {\n    a_go(&x);\n    return 0;\n}\n',
        },
        "a.c -> b.c (by function b_find) -> a.c (by function a_go)",
    ),
    "a call against an include": (
        {
            "low.h": "void low(void);\n",
            "low.c": '#include "low.h"\nvoid top(void);\nvoid low(void) { top(); }\n',
            "top.c": '#include "low.h"\n_Noreturn void top(void) { low(); }\n',
        },
        "low.c -> top.c (by function top) -> low.c (by including low.h)",
    ),
    "a function that is handed over": (
        {
            "a.c": "void b(void (*f)(void));\nvoid a(void) {}\nvoid go(void) { b(a); }\n",
            "b.c": "void a(void);\nstruct row { void (*f)(void); } row = {a};\n"
            "void b(void (*f)(void),\n       int more) {\n    f();\n}\n",
        },
        "a.c -> b.c (by function b) -> a.c (by function a)",
    ),
}


@pytest.mark.parametrize("name", CIRCLES)
def test_catches_circles(tree: Path, name: str) -> None:
    files, circle = CIRCLES[name]
    for path, text in files.items():
        write(tree, f"firmware/link/{path}", text)
    done = check_tree(tree)
    assert done.returncode == 1
    assert done.stdout == f"firmware/link: circle {circle}\n"


@pytest.mark.parametrize("folder", ["firmware/ilc", "hal/sam3x8e", "hal/host", "sim", "sim/water"])
def test_looks_for_circles_everywhere(tree: Path, folder: str) -> None:
    write(tree, f"{folder}/a.h", '#include "b.h"\n')
    write(tree, f"{folder}/b.h", '#include "a.h"\n')
    done = check_tree(tree)
    assert done.stdout.startswith(f"{folder}: circle a.h -> b.h")


def test_what_is_no_circle(tree: Path) -> None:
    """Functions of the same name for a file alone, fields, words of comments and of texts."""
    write(tree, "firmware/link/b.h", "void b(void);\n")
    write(
        tree,
        "firmware/link/a.c",
        '#include "b.h"\n#include "a.h"\nvoid a(void) { b(); }\nvoid own(void) {}\n',
    )
    write(tree, "firmware/link/a.h", "void a(void);\n")
    write(
        tree,
        "firmware/link/b.c",
        '#include "b.h"\n/* a() calls it */\nstatic const char text[] = "a";\n'
        "static __attribute__((noinline)) int own(void) { return 0; }\n"
        "void b(void) { x.a = y->a + own() + 'a'; }\n",
    )
    done = check_tree(tree)
    assert done.returncode == 0, done.stdout


def test_folders_that_have_circles_left(tree: Path) -> None:
    write(tree, "firmware/link/a.h", '#include "b.h"\n')
    write(tree, "firmware/link/b.h", '#include "a.h"\n')
    assert check(tree, "--circles-left", "firmware/link").returncode == 0
    done = check(tree, "--circles-left", "firmware/link", "firmware/app")
    assert done.returncode == 1
    assert done.stdout.startswith("firmware/app: has no circle;")


@pytest.mark.parametrize("name", ["hal_servo_pulse_isr", "hal_guard_open_isr", "monitor_tick_isr"])
def test_only_the_tick_reaches_the_servo(tree: Path, name: str) -> None:
    write(tree, "firmware/app/control.c", f"void tick(void) {{ {name}(0); }}\n")
    assert check_tree(tree).returncode == 0
    write(tree, "firmware/app/app.c", f"void other(void) {{ {name}(0); }}\n")
    done = check_tree(tree)
    assert done.returncode == 1
    assert f"only control.c may call {name}()" in done.stdout
