"""Worst-case stack of a Cortex-M image, from its machine code.

Who calls whom is read off the disassembly of the linked image. How much a function pushes is the
larger of what the disassembly shows and what the compiler says of the functions it compiled
(-fstack-usage, .su files). What machine code does not say (callees of a call through a pointer,
priority of an interrupt, bound of a recursion) stands in a table, see Facts. Whatever the table
lacks is an error: the figure is never a guess.
"""

from __future__ import annotations

import bisect
import re
import subprocess
import tomllib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from elftools.elf.elffile import ELFFile
from elftools.elf.sections import SymbolTableSection

# What the core pushes when it takes an exception: eight words, and one to align (ARMv7-M, B1.5.7).
EXCEPTION_BYTES = 32 + 4
ADDRESSES = 1 << 32
OBJDUMP = "arm-none-eabi-objdump"
NM = "arm-none-eabi-nm"
ADDR2LINE = "arm-none-eabi-addr2line"

HEADER = re.compile(r"^([0-9a-f]+) <([^>]+)>:$")
LINE = re.compile(r"^\s+([0-9a-f]+):\t([0-9a-f ]+?)\s*\t([a-z0-9._]+)\s*(.*)$")
TARGET = re.compile(r"([0-9a-f]+) <[^>]+>")
BRANCH = re.compile(r"^(b|b(eq|ne|cs|cc|mi|pl|vs|vc|hi|ls|ge|lt|gt|le)|cbn?z)(\.[nw])?$")
ENDS = re.compile(r"^(b(\.[nw])?|bx|bl|udf|tbb|tbh|\.word|\.short|\.byte|\.hword)$")
REGISTER_RANGE = re.compile(r"^r(\d+)-r(\d+)$")


class StackError(Exception):
    """The worst case cannot be told; the text says what is missing."""


@dataclass(frozen=True)
class Facts:
    """What machine code does not say. Names are without the compiler's suffixes (.constprop.0); one
    that several files use is written file.c:name.

    ``calls``: function that calls through a pointer -> all that may be behind it.
    ``priority``: interrupt handler -> priority level; equal levels do not interrupt each other.
    ``own_stack``: handler -> what it goes on to on a stack of its own -> name of that stack.
    ``recursion``: function -> how often it can be on the stack at once.
    """

    calls: dict[str, tuple[str, ...]] = field(default_factory=dict)
    priority: dict[str, int] = field(default_factory=dict)
    own_stack: dict[str, tuple[str, str]] = field(default_factory=dict)
    recursion: dict[str, int] = field(default_factory=dict)

    @staticmethod
    def read(path: Path) -> Facts:
        """From a TOML file with a table per member."""
        text: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8"))
        return Facts(
            {name: tuple(callees) for name, callees in text.get("calls", {}).items()},
            dict(text.get("priority", {})),
            {name: (row["runs"], row["stack"]) for name, row in text.get("own_stack", {}).items()},
            dict(text.get("recursion", {})),
        )


@dataclass(frozen=True)
class Call:
    """An edge; a ``tail`` call leaves after the caller's frame is gone."""

    callee: int
    tail: bool


@dataclass
class Function:
    """One function of the image. ``compiled``: the compiler told its frame; such code calls in its
    last line only after the frame is gone."""

    address: int
    name: str
    end: int  # what lies between here and the next function only fills up
    frame_bytes: int = 0
    compiled: bool = False
    calls: list[Call] = field(default_factory=list)
    pointer_calls: list[int] = field(default_factory=list)  # where, callee unknown
    pointer_calls_are_tail: bool = True


@dataclass(frozen=True)
class Symbol:
    name: str
    address: int
    size: int
    file: str  # path of its source, "" when no debug information tells it
    kind: str  # STT_FUNC, STT_OBJECT, STT_NOTYPE


@dataclass(frozen=True)
class Chain:
    """A path of calls: bytes in use at its end, and the functions on it."""

    bytes: int
    names: tuple[str, ...]


@dataclass(frozen=True)
class Level:
    """The deepest interrupt of a priority level, exception frame included."""

    priority: int
    deepest: Chain


@dataclass(frozen=True)
class OwnStack:
    """A handler's stack of its own, and what it needs there."""

    name: str
    size_bytes: int
    deepest: Chain


@dataclass(frozen=True)
class StackReport:
    """``largest``: the function that moves the stack pointer furthest; ``guard_bytes``: what lies
    below the stack to catch it."""

    main: Chain
    levels: tuple[Level, ...]
    own: tuple[OwnStack, ...]
    reserved_bytes: int
    largest: Chain
    guard_bytes: int

    @property
    def worst_bytes(self) -> int:
        """Main program, one interrupt of each level on top of it, and a fault on top of all."""
        return self.main.bytes + sum(level.deepest.bytes for level in self.levels) + EXCEPTION_BYTES


def base_name(name: str) -> str:
    """A function's name as in the source, without what the compiler appends to its clones."""
    return name.split(".")[0]


def output_of(*command: str) -> str:
    """What a tool of the compiler prints. Raises StackError with its message."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise StackError(done.stderr.strip())
    return done.stdout


def source_files(elf_path: Path) -> dict[int, str]:
    """Source of each symbol by address: link-time optimisation leaves it to debug information."""
    placed = re.findall(r"^([0-9a-f]+) \w \S+\t(.+):\d+$", output_of(NM, "-l", str(elf_path)), re.M)
    return {int(address, 16): file for address, file in placed}


def innermost(elf_path: Path, places: list[int]) -> dict[int, str]:
    """The function of the source that each instruction is from, be it inlined into another; "" when
    no debug information tells it."""
    if not places:
        return {}
    command = [ADDR2LINE, "-f", "-e", str(elf_path), *map(hex, places)]
    names = output_of(*command).splitlines()[::2]
    return {at: "" if name == "??" else name for at, name in zip(places, names, strict=True)}


def symbols(elf_path: Path) -> list[Symbol]:
    """All symbols with an address."""
    found: list[Symbol] = []
    files = source_files(elf_path)
    with elf_path.open("rb") as stream:
        table = ELFFile(stream).get_section_by_name(".symtab")
        if not isinstance(table, SymbolTableSection):
            raise StackError("the image has no symbols")
        for entry in table.iter_symbols():
            kind = entry["st_info"]["type"]
            unplaced = kind == "STT_FILE" or entry["st_shndx"] == "SHN_UNDEF"
            if entry.name and not unplaced and not entry.name.startswith("$"):
                address = entry["st_value"] & ~1 if kind == "STT_FUNC" else entry["st_value"]
                size = entry["st_size"]
                found.append(Symbol(entry.name, address, size, files.get(address, ""), kind))
    return found


def compiler_frames(folder: Path) -> dict[tuple[str, str], int]:
    """Frames from all .su files below |folder|: (file, function) -> bytes, and ("", function).

    The compiler leaves out the numbers of a function's clones, so the largest counts. A file that
    link-time optimisation wrote names its sources in its lines, like any other.
    """
    frames: dict[tuple[str, str], int] = {}
    for path in sorted(folder.rglob("*.su")):
        for line in path.read_text(encoding="utf-8").splitlines():
            place, size, kind = line.split("\t")
            source, _, _, name = place.rsplit(":", 3)
            if kind == "dynamic":
                raise StackError(f"{name} ({source}) has a frame of a size known only as it runs")
            for key in ((Path(source).name, base_name(name)), ("", base_name(name))):
                frames[key] = max(frames.get(key, 0), int(size))
    return frames


def pushed_bytes(mnemonic: str, operands: str) -> int:
    """By how much an instruction moves the stack pointer down; 0 for all others."""
    if mnemonic in ("push", "push.w") or (
        mnemonic in ("stmdb", "stmfd") and operands.startswith("sp!")
    ):
        return 4 * register_count(operands[operands.index("{") + 1 : operands.index("}")])
    if match := re.match(r"^(?:\w+, )+\[sp, #-(\d+)\]!", operands):
        return int(match[1])
    if mnemonic in ("sub", "sub.w", "subw") and (
        match := re.match(r"^sp, (?:sp, )?#(\d+)", operands)
    ):
        return int(match[1])
    return 0


def register_count(names: str) -> int:
    """How many registers a list such as "r4-r7, lr" has."""
    count = 0
    for name in names.split(","):
        match = REGISTER_RANGE.match(name.strip())
        count += int(match[2]) - int(match[1]) + 1 if match else 1
    return count


class Program:
    """The call graph of an image."""

    def __init__(self, elf_path: Path, su_folder: Path, facts: Facts) -> None:
        self.symbols = symbols(elf_path)
        self._by_name = {symbol.name: symbol for symbol in self.symbols}
        with elf_path.open("rb") as stream:
            self._vectors = self._read_vectors(ELFFile(stream))
        self.facts = facts
        self.functions: dict[int, Function] = {}
        self._read_code(elf_path)
        self._set_frames(compiler_frames(su_folder))
        self._resolve_pointers(elf_path)
        self._depths: dict[int, Chain] = {}

    def symbol(self, name: str) -> Symbol:
        if name not in self._by_name:
            raise StackError(f"the image has no symbol {name}")
        return self._by_name[name]

    def distance(self, low: str, high: str) -> int:
        """Bytes from one symbol up to the other."""
        return self.symbol(high).address - self.symbol(low).address

    def largest(self) -> Chain:
        """The function with the largest frame."""
        function = max(self.functions.values(), key=lambda f: f.frame_bytes)
        return Chain(function.frame_bytes, (function.name,))

    def handlers(self) -> list[str]:
        """Everything the vector table goes to but reset, each once."""
        names = {self.functions[address].name for address in self._vectors[2:] if address}
        return sorted(base_name(name) for name in names)

    def reset(self) -> int:
        return self._vectors[1]

    def named(self, name: str) -> list[int]:
        """Addresses of all functions that a name in a table means; at least one."""
        file, _, function = name.rpartition(":")
        found = {
            symbol.address
            for symbol in self.symbols
            if symbol.address in self.functions
            and base_name(symbol.name) == function
            and file in ("", Path(symbol.file).name)
        }
        if not found:
            raise StackError(f"the tables name {name}, which the image lacks")
        return sorted(found)

    def deepest(self, address: int) -> Chain:
        """The deepest path from a function downwards, its own frame included."""
        if not self._depths:
            self._measure()
        return self._depths[address]

    def _read_vectors(self, elf: ELFFile) -> list[int]:
        table = self.symbol("vectors")
        for section in elf.iter_sections():
            start = section["sh_addr"]
            if start <= table.address < start + section["sh_size"]:
                at = table.address - start
                data = section.data()[at : at + table.size]
                words = [data[i : i + 4] for i in range(0, len(data), 4)]
                return [int.from_bytes(word, "little") & ~1 for word in words]
        raise StackError("the vector table lies in no section")

    def _read_code(self, elf_path: Path) -> None:
        lines = output_of(OBJDUMP, "--disassemble", "--wide", str(elf_path)).splitlines()
        starts = [match for match in map(HEADER.match, lines) if match]
        sizes = {s.address: s.size for s in self.symbols if s.kind == "STT_FUNC" and s.size}
        for start in starts:
            address = int(start[1], 16)
            end = address + sizes.get(address, ADDRESSES)
            self.functions[address] = Function(address, start[2], end)
        self._starts = sorted(self.functions)
        current: Function | None = None
        last = ""
        for line in lines:
            if header := HEADER.match(line):
                following = self.functions[int(header[1], 16)]
                if current and last and not ends(last):
                    current.calls.append(Call(following.address, tail=True))
                current, last = following, ""
            elif current and (match := LINE.match(line)) and int(match[1], 16) < current.end:
                self._read_instruction(current, int(match[1], 16), match[3], match[4])
                last = f"{match[3]} {match[4]}"

    def _read_instruction(self, function: Function, at: int, mnemonic: str, operands: str) -> None:
        function.frame_bytes += pushed_bytes(mnemonic, operands)
        target = TARGET.search(operands)
        if mnemonic == "bl" and target:
            function.calls.append(Call(self._function_at(int(target[1], 16)), tail=False))
        elif BRANCH.match(mnemonic) and target:
            callee = self._function_at(int(target[1], 16))
            if callee != function.address:
                function.calls.append(Call(callee, tail=True))
        elif mnemonic == "blx" or (mnemonic == "bx" and not operands.startswith("lr")):
            function.pointer_calls.append(at)
            function.pointer_calls_are_tail &= mnemonic == "bx"

    def _function_at(self, address: int) -> int:
        return self._starts[bisect.bisect_right(self._starts, address) - 1]

    def _set_frames(self, compiled: dict[tuple[str, str], int]) -> None:
        files = {s.address: Path(s.file).name for s in self.symbols if s.kind == "STT_FUNC"}
        for function in self.functions.values():
            name = base_name(function.name)
            frame = compiled.get((files.get(function.address, ""), name), compiled.get(("", name)))
            if frame is not None:
                # The compiler's figure lacks the registers of a struct that came half in them.
                function.frame_bytes = max(frame, function.frame_bytes)
                function.compiled = True

    def _resolve_pointers(self, elf_path: Path) -> None:
        """Edges for the calls through pointers, from the table of calls."""
        callers = [(f, at) for f in self.functions.values() for at in f.pointer_calls]
        unused = set(self.facts.calls)
        written_in = innermost(elf_path, [at for _, at in callers])
        for function, at in callers:
            name = written_in.get(at) or base_name(function.name)
            if name not in self.facts.calls:
                raise StackError(
                    f"{name} calls through a pointer ({at:#x}): say in the table of "
                    f"calls what may be behind it"
                )
            for address in (a for callee in self.facts.calls[name] for a in self.named(callee)):
                function.calls.append(Call(address, function.pointer_calls_are_tail))
            unused.discard(name)
        if unused:
            names = ", ".join(sorted(unused))
            raise StackError(f"the table of calls names {names}, which calls through no pointer")

    def _measure(self) -> None:
        for group in components(self.functions):
            repeats = self._repeats(group)
            inside = repeats * sum(self.functions[member].frame_bytes for member in group)
            for address in group:
                out = self._chain_out_of(address, group)
                if repeats:
                    whole = out.bytes - self.functions[address].frame_bytes + inside
                    out = Chain(whole, out.names)
                self._depths[address] = out

    def _repeats(self, group: tuple[int, ...]) -> int:
        """0 when the group is a single function that does not call itself."""
        calls_itself = any(c.callee == group[0] for c in self.functions[group[0]].calls)
        if len(group) == 1 and not calls_itself:
            return 0
        names = sorted(base_name(self.functions[address].name) for address in group)
        bounds = [self.facts.recursion[name] for name in names if name in self.facts.recursion]
        if not bounds:
            raise StackError(
                f"recursion without a bound: {', '.join(names)}; say in the table of recursions "
                f"how often one of them can be on the stack at once"
            )
        return min(bounds)

    def _chain_out_of(self, address: int, group: tuple[int, ...]) -> Chain:
        """Deepest from |address| on; within a recursive group the deepest way out of any member."""
        best = Chain(self.functions[address].frame_bytes, (self.functions[address].name,))
        for member in group:
            for call in self.functions[member].calls:
                if call.callee in group:
                    continue
                below = self._depths[call.callee]
                frame = self.functions[address].frame_bytes
                kept = 0 if call.tail and self.functions[member].compiled else frame
                if kept + below.bytes > best.bytes:
                    names = (self.functions[address].name, *below.names)
                    best = Chain(kept + below.bytes, names)
        return best


def ends(instruction: str) -> bool:
    """Whether the code behind this instruction is not reached from it."""
    mnemonic, _, operands = instruction.partition(" ")
    return bool(ENDS.match(mnemonic)) or re.search(r"\bpc\b", operands) is not None


def components(functions: dict[int, Function]) -> Iterator[tuple[int, ...]]:
    """Groups of functions that call each other in a circle, callees first (Tarjan's algorithm)."""
    index: dict[int, int] = {}
    low: dict[int, int] = {}
    stack: list[int] = []
    for root in functions:
        if root in index:
            continue
        work: list[tuple[int, Iterator[Call]]] = []

        def enter(node: int, work: list[tuple[int, Iterator[Call]]] = work) -> None:
            index[node] = low[node] = len(index)
            stack.append(node)
            work.append((node, iter(functions[node].calls)))

        enter(root)
        while work:
            node, calls = work[-1]
            for call in calls:
                if call.callee not in index:
                    enter(call.callee)
                    break
                if call.callee in stack:
                    low[node] = min(low[node], index[call.callee])
            else:
                work.pop()
                if work:
                    low[work[-1][0]] = min(low[work[-1][0]], low[node])
                if low[node] == index[node]:
                    at = stack.index(node)
                    yield tuple(stack[at:])
                    del stack[at:]


def levels(program: Program, handlers: Iterable[str]) -> tuple[Level, ...]:
    """The deepest handler of each priority."""
    deepest: dict[int, Chain] = {}
    for name in handlers:
        if name not in program.facts.priority:
            raise StackError(f"{name} is in the vector table, but its priority is in no table")
        priority = program.facts.priority[name]
        for address in program.named(name):
            path = program.deepest(address)
            found = Chain(path.bytes + EXCEPTION_BYTES, path.names)
            if priority not in deepest or found.bytes > deepest[priority].bytes:
                deepest[priority] = found
    return tuple(Level(priority, deepest[priority]) for priority in sorted(deepest))


def own_stacks(program: Program) -> tuple[OwnStack, ...]:
    """The stacks that handlers bring along."""
    found = []
    for runs, stack in program.facts.own_stack.values():
        deepest = max((program.deepest(a) for a in program.named(runs)), key=lambda p: p.bytes)
        found.append(OwnStack(stack, program.symbol(stack).size, deepest))
    return tuple(found)


def measure(elf: Path, su_folder: Path, facts: Facts) -> StackReport:
    """The worst case of an image. Raises StackError when it cannot be told."""
    program = Program(elf, su_folder, facts)
    on_main = [name for name in program.handlers() if name not in facts.own_stack]
    return StackReport(
        program.deepest(program.reset()),
        levels(program, on_main),
        own_stacks(program),
        program.distance("__stack_bottom", "__stack_top"),
        program.largest(),
        program.distance("__stack_guard", "__stack_bottom"),
    )
