"""The size tool on small images: what it adds up, and what it refuses to guess."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
TOOL = ROOT / "tools" / "size_report.py"
CC = "arm-none-eabi-gcc"

pytestmark = pytest.mark.skipif(
    shutil.which(CC) is None, reason=f"{CC} is missing: tools/bootstrap size"
)

EXCEPTION = 36

LINKER_SCRIPT = """
MEMORY { rom (rx) : ORIGIN = 0x80000, LENGTH = 256K
         ram (rw) : ORIGIN = 0x20070000, LENGTH = 96K }
__stack_top = ORIGIN(ram) + LENGTH(ram);
__stack_bottom = __stack_top - STACK_BYTES;
__stack_guard = __stack_bottom - 1K;
SECTIONS {
    .text : { KEEP(*(.vectors)) *(.text .text.*) *(.rodata .rodata.*) } >rom
    .data : { *(.data .data.*) } >ram AT>rom
    .bss (NOLOAD) : { *(.bss .bss.* COMMON) } >ram
}
"""

# Frames of a known size, in assembly: no compiler has a say in them.
PROLOGUE = """
    .syntax unified
    .thumb
    .macro function name
    .type \\name, %function
    .global \\name
    .thumb_func
    \\name:
    .endm
    .macro finish name
    .size \\name, . - \\name
    .endm
    .section .vectors, "a"
    .type vectors, %object
    vectors: .word 0x20088000
"""

# reset 8 -> middle 8 + 40 -> leaf 16; the other way is shallower.
CHAIN = """
    .word reset, {handlers}
    .size vectors, . - vectors
    .text
    function reset
        push {{r4, lr}}
        bl other
        bl middle
        pop {{r4, pc}}
    finish reset
    function middle
        push {{r7, lr}}
        sub sp, #40
        bl leaf
        add sp, #40
        pop {{r7, pc}}
    finish middle
    function other
        push {{lr}}
        pop {{pc}}
    finish other
    .zero 3
    .balign 4
    function leaf
        stmdb sp!, {{r4, r5, r6}}
        str r0, [sp, #-4]!
        add sp, #4
        ldmia sp!, {{r4, r5, r6}}
        bx lr
    finish leaf
"""


class Bench:
    """Builds images in a folder and runs the tool on them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.stack_bytes = 4096
        self.facts = ""

    def build(self, source: str, suffix: str = ".S") -> None:
        (self.folder / "image.ld").write_text(LINKER_SCRIPT)
        code = self.folder / f"code{suffix}"
        code.write_text(source)
        flags = ["-mcpu=cortex-m3", "-mthumb", "-Os", "-g", "-fstack-usage", "-nostdlib"]
        self._run(CC, *flags, "-c", str(code), "-o", str(self.folder / "code.o"))
        link = [f"-T{self.folder / 'image.ld'}", f"-Wl,--defsym=STACK_BYTES={self.stack_bytes}"]
        link += [f"-Wl,-Map={self.folder / 'image.map'}", str(self.folder / "code.o"), "-lgcc"]
        self._run(CC, *flags, *link, "-o", str(self.folder / "image.elf"))

    def tool(self, *options: str) -> subprocess.CompletedProcess[str]:
        table = self.folder / "facts.toml"
        table.write_text(self.facts)
        command = [sys.executable, str(TOOL), str(self.folder / "image.elf")]
        command += ["--facts", str(table), *options]
        return subprocess.run(command, capture_output=True, text=True, check=False)

    def report(self) -> dict[str, Any]:
        done = self.tool("--json")
        assert done.returncode == 0, done.stderr
        found: dict[str, Any] = json.loads(done.stdout)
        return found

    def main_stack(self) -> int:
        return int(self.report()["stack"]["main"]["bytes"])

    def refusal(self) -> str:
        done = self.tool()
        assert done.returncode == 1
        assert done.stderr.startswith("size: ")
        assert "Traceback" not in done.stderr
        return done.stderr

    def _run(self, *command: str) -> None:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def chain(handlers: str = "0", more: str = "") -> str:
    return PROLOGUE + CHAIN.format(handlers=handlers) + more


def function(name: str, *body: str) -> str:
    lines = "\n        ".join(body)
    return f"\n    function {name}\n        {lines}\n    finish {name}\n"


def test_the_deepest_chain_is_added_up(bench: Bench) -> None:
    bench.build(chain())
    stack = bench.report()["stack"]
    assert stack["main"] == {"bytes": 8 + 48 + 16, "names": ["reset", "middle", "leaf"]}
    assert stack["worst_bytes"] == 72 + EXCEPTION
    assert stack["reserved_bytes"] == 4096


def test_of_each_priority_the_deepest_interrupt_counts(bench: Bench) -> None:
    more = function("shallow_isr", "push {r4, lr}", "pop {r4, pc}")
    more += function("deep_isr", "push {r4, r5, r6, lr}", "pop {r4, r5, r6, pc}")
    more += function("urgent_isr", "push {r4-r8, lr}", "pop {r4-r8, pc}")
    bench.build(chain("shallow_isr, deep_isr, 0, urgent_isr, deep_isr", more))
    bench.facts = "[priority]\nshallow_isr = 8\ndeep_isr = 8\nurgent_isr = 2\n"
    stack = bench.report()["stack"]
    levels = {row["priority"]: row["deepest"]["bytes"] for row in stack["levels"]}
    assert levels == {2: 24 + EXCEPTION, 8: 16 + EXCEPTION}
    assert stack["worst_bytes"] == 72 + 24 + 16 + 3 * EXCEPTION


def test_a_handler_without_a_priority_is_refused(bench: Bench) -> None:
    bench.build(chain("some_isr", function("some_isr", "bx lr")))
    assert "some_isr is in the vector table" in bench.refusal()


def test_a_handler_with_a_stack_of_its_own_is_measured_against_that(bench: Bench) -> None:
    more = function("fault_isr", "ldr sp, =emergency + 16", "b carry_on", ".ltorg")
    more += function("carry_on", "push {r0-r3, lr}", "pop {r0-r3, pc}")
    more += "\n    .bss\n    .type emergency, %object\n    emergency: .zero 16\n"
    more += "    .size emergency, 16\n"
    bench.build(chain("fault_isr", more))
    bench.facts = '[own_stack]\nfault_isr = { runs = "carry_on", stack = "emergency" }\n'
    done = bench.tool("--json")
    found = json.loads(done.stdout)
    assert found["stack"]["worst_bytes"] == 72 + EXCEPTION
    assert done.returncode == 1
    assert "stack emergency: 20 bytes, 4 more than it holds (16)" in done.stderr


def test_a_call_through_a_pointer_wants_its_callees(bench: Bench) -> None:
    more = function("caller", "push {r4, lr}", "blx r3", "pop {r4, pc}")
    more += function("small", "push {lr}", "pop {pc}")
    more += function("large", "push {r4-r11, lr}", "pop {r4-r11, pc}")
    bench.build(chain(more=more).replace("bl other", "bl caller"))
    assert "caller calls through a pointer (0x" in bench.refusal()
    bench.facts = '[calls]\ncaller = ["small", "large", "leaf"]\n'
    assert bench.main_stack() == max(72, 8 + 8 + 36)
    bench.facts = '[calls]\ncaller = ["middle"]\n'
    assert bench.main_stack() == 8 + 8 + 48 + 16


@pytest.mark.parametrize(
    ("row", "says"),
    [
        ('caller = ["gone"]', "name gone, which the image lacks"),
        ('caller = ["leaf"]\nleaf = ["leaf"]', "names leaf, which calls through no pointer"),
    ],
)
def test_a_table_that_is_out_of_date_is_refused(bench: Bench, row: str, says: str) -> None:
    bench.build(chain(more=function("caller", "push {r4, lr}", "blx r3", "pop {r4, pc}")))
    bench.facts = f"[calls]\n{row}\n"
    assert says in bench.refusal()


def test_recursion_wants_a_bound(bench: Bench) -> None:
    more = function("ping", "push {r4, lr}", "bl pong", "pop {r4, pc}")
    more += function("pong", "push {r4-r6, lr}", "bl ping", "bl leaf", "pop {r4-r6, pc}")
    bench.build(chain(more=more).replace("bl other", "bl ping"))
    assert "recursion without a bound: ping, pong" in bench.refusal()
    bench.facts = "[recursion]\nping = 3\n"
    assert bench.main_stack() == 8 + 3 * (8 + 16) + 16


def test_a_function_that_calls_itself_wants_a_bound_too(bench: Bench) -> None:
    more = function("again", "push {r4, lr}", "bl again", "pop {r4, pc}")
    bench.build(chain(more=more).replace("bl other", "bl again"))
    assert "recursion without a bound: again" in bench.refusal()
    bench.facts = "[recursion]\nagain = 20\n"
    assert bench.main_stack() == 8 + 20 * 8


C_SOURCE = """
void leaf(char *);
__attribute__((noinline)) void leaf(char *bytes) { __asm__ volatile("" : : "r"(bytes)); }
__attribute__((noinline)) static int at_the_end(int x) {
    char bytes[200];
    leaf(bytes);
    return x + bytes[3];
}
__attribute__((noinline)) static int tail(int x) {
    char bytes[100];
    leaf(bytes);
    return at_the_end(x + bytes[1]);
}
volatile float zero;
int reset(void);
int reset(void) { return tail((int)(zero / 3.0f)); }
__attribute__((used, section(".vectors"))) int (*const vectors[2])(void) = {0, reset};
"""


def test_compiled_code_counts_as_the_compiler_says_and_tail_calls_leave_their_frame(
    bench: Bench,
) -> None:
    bench.build(C_SOURCE, ".c")
    frames = {}
    for line in (bench.folder / "code.su").read_text().splitlines():
        place, size, _ = line.split("\t")
        frames[place.rsplit(":", 1)[1]] = int(size)
    assert frames["at_the_end"] >= 200
    assert frames["tail"] >= 100
    assert bench.main_stack() == frames["at_the_end"] + frames["leaf"]


def test_a_struct_that_comes_half_in_registers_counts_whole(bench: Bench) -> None:
    """The compiler's own figure lacks the eight bytes."""
    taking = """
typedef struct { int word[3]; } three_t;
void leaf(void *);
__attribute__((noinline)) void leaf(void *at) { __asm__ volatile("" : : "r"(at)); }
__attribute__((noipa)) static int take(int a, int b, three_t three) {
    leaf(&three);
    return a + b + three.word[1];
}
int reset(void);
int reset(void) { return take(1, 2, (three_t){{1, 2, 3}}) + 1; }
__attribute__((used, section(".vectors"))) int (*const vectors[2])(void) = {0, reset};
"""
    bench.build(taking, ".c")
    with_struct = bench.main_stack()
    compiler = sum(
        int(line.split("\t")[1]) for line in (bench.folder / "code.su").read_text().splitlines()
    )
    assert with_struct == compiler + 8


def test_a_pointer_call_belongs_to_the_function_that_it_was_written_in(bench: Bench) -> None:
    """Wherever the compiler inlined it."""
    inlined = """
static inline __attribute__((always_inline)) int ask(int (*volatile *answers)(int), int x) {
    return (*answers)(x) + 1;
}
static int answer(int x) { char bytes[50]; __asm__ volatile("" : : "r"(bytes)); return x; }
int (*volatile answers)(int) = answer;
int reset(void);
int reset(void) { return ask(&answers, 2); }
__attribute__((used, section(".vectors"))) int (*const vectors[2])(void) = {0, reset};
"""
    bench.build(inlined, ".c")
    assert "ask calls through a pointer (0x" in bench.refusal()
    bench.facts = '[calls]\nask = ["code.c:answer"]\n'
    assert bench.report()["stack"]["main"]["names"] == ["reset", "answer"]


def test_a_frame_of_unknown_size_is_refused(bench: Bench) -> None:
    grows = C_SOURCE.replace("char bytes[200]", "char bytes[x]")
    bench.build(grows, ".c")
    assert "at_the_end" in bench.refusal()


def test_a_frame_that_could_step_over_the_guard_is_refused(bench: Bench) -> None:
    more = function("wide", "sub sp, #508", "sub sp, #508", "sub sp, #{}", "bx lr")
    bench.build(chain(more=more.format(8)))
    assert bench.report()["stack"]["largest"] == {"bytes": 1024, "names": ["wide"]}
    bench.build(chain(more=more.format(12)))
    assert "largest frame: 1028 bytes, 4 more than the stack's guard (1024)" in bench.refusal()


def test_code_that_runs_from_ram_counts_in_both(bench: Bench) -> None:
    more = '\n    .section .data.code, "ax"\n' + function("in_ram", "nop", "bx lr")
    bench.build(chain(more=more))
    found = bench.report()
    assert found["data"] == 4
    assert found["image"] == found["text"] + 4


def test_sizes_and_parts(bench: Bench) -> None:
    more = "\n    .data\n    .zero 8\n    .bss\n    .type big, %object\n"
    bench.build(chain(more=more + "    big: .zero 500\n    .size big, 500\n"))
    found = bench.report()
    assert found["data"] == 8
    assert found["bss"] == 500
    assert found["image"] == found["text"] + 8
    assert found["ram"] == 508 + found["stack"]["worst_bytes"]
    assert found["biggest"][0]["name"] == "big"
    assert found["parts"] == {"constants": found["text"]}


@pytest.mark.parametrize(
    ("more", "stack_bytes", "says"),
    [
        ("\n.section .rodata\n.zero 102400\n", 4096, "text and data: "),
        ("\n.bss\n.zero 65500\n", 4096, "variables and worst stack: "),
        ("", 100, "worst stack: 108 bytes, 8 more than the linker script reserves (100)"),
    ],
)
def test_over_budget(bench: Bench, more: str, stack_bytes: int, says: str) -> None:
    bench.stack_bytes = stack_bytes
    bench.build(chain(more=more))
    assert says in bench.refusal()


def test_no_image(bench: Bench) -> None:
    assert "make firmware" in bench.refusal()
