"""Checks the structure of the host package; `lint-imports` checks the order of its layers.

Prints one line per offence and exits with 1 when there is one. With --counts it prints the numbers.
"""

from __future__ import annotations

import argparse
import ast
import graphlib
import statistics
import sys
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import grimp

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = "tailbeat"

# How things are; these numbers and lists only get smaller. The goals: 230 files, 36 000 lines. They
# grew eleven times: by a second plant, learned scatter, honest sigmas and the IMU's calibration; by
# the guided job (start, health, measure, the law of each input); by the diagnosis of every trial,
# the stream of what the board reports, the demo's two laws and the page that leads through the
# whole job; by recordings as rows and fits of many trials at once; by the comparison of departures;
# by what connected commands load apart from the rest; by a trial's conversation in C, what is kept
# of trials and bounds, and the cost of an idle page; by exports with units and wall-clock time
# (MCAP with films, ULog); by what works without the clone (the packaged image and tests, flashing
# as a dry run); by one place for what differs between systems, each function of which can be faked;
# by the ledger of the thesis's claims, with those of section 8.5.2 and the bounds of its theorems,
# all of its figures under their own numbers, and the paper made of both; by the studies of its
# section 9.2 with a comparison of every figure with its text; by starts that wait for a flash,
# and by what only some commands load.
FILES_MAX = 298
CODE_LINES_MAX = 45_620
IMPORTS_IN_FUNCTIONS_MAX = 1
LONGER_FILES: dict[str, int] = {}  # path below the package: lines, with the reason beside it

FILE_LINES_MAX = 450
FUNCTION_LINES_MAX = 60  # its options apart, when it is a command
DTYPE_ALIASES = "core/arrays.py"  # the only file that names an NDArray type

Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass
class Module:
    """One file and what is counted in it."""

    path: str
    tree: ast.Module
    text: str

    @property
    def lines(self) -> int:
        return self.text.count("\n")

    @property
    def code_lines(self) -> int:
        """Lines that hold code: no docstring, no comment, not blank."""
        skip = {
            line
            for node in ast.walk(self.tree)
            if isinstance(node, ast.Module | ast.ClassDef | Function)
            and ast.get_docstring(node, clean=False) is not None
            for line in range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1)
        }
        return sum(
            bool(line.strip()) and not line.lstrip().startswith("#") and number not in skip
            for number, line in enumerate(self.text.splitlines(), 1)
        )

    def functions(self) -> Iterator[Function]:
        return (node for node in ast.walk(self.tree) if isinstance(node, Function))

    def imports_in_functions(self) -> Iterator[int]:
        """The line of each name of the package that is imported inside a function."""
        for function in self.functions():
            for node in ast.walk(function):
                if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(PACKAGE):
                    yield from (node.lineno for _ in node.names)


def body_lines(function: Function) -> int:
    """Lines of a function; of a command (Annotated options) those of its body."""
    whole = (function.end_lineno or 0) - function.lineno + 1
    options = "Annotated" in ast.dump(function.args)
    return (function.end_lineno or 0) - function.body[0].lineno + 1 if options else whole


def modules(top: Path) -> list[Module]:
    """All files of the package except the generated MAVLink dialect."""
    found = []
    for path in sorted(top.rglob("*.py")):
        if path.name != "_dialect.py":
            text = path.read_text(encoding="utf-8")
            found.append(Module(path.relative_to(top).as_posix(), ast.parse(text), text))
    return found


def class_offences(found: list[Module]) -> Iterator[str]:
    """Class names that two files use, and names of array types outside their one file."""
    where: dict[str, set[str]] = defaultdict(set)
    for module in found:
        for node in ast.walk(module.tree):
            if isinstance(node, ast.ClassDef):
                where[node.name].add(module.path)
        for statement in module.tree.body:
            said = ast.dump(statement.value) if isinstance(statement, ast.Assign) else ""
            if "NDArray" in said and "float" in said and module.path != DTYPE_ALIASES:
                yield f"{module.path}:{statement.lineno}: array types are in {DTYPE_ALIASES}"
    for name, paths in sorted(where.items()):
        if len(paths) > 1:
            yield f"class {name} is in {', '.join(sorted(paths))}"


def size_offences(found: list[Module]) -> Iterator[str]:
    """What is too long, and too much of it."""
    for module in found:
        most = LONGER_FILES.get(module.path, FILE_LINES_MAX)
        if module.lines > most:
            yield f"{module.path}: {module.lines} lines, at most {most}"
        for function in module.functions():
            if body_lines(function) > FUNCTION_LINES_MAX:
                yield f"{module.path}:{function.lineno}: {function.name} is too long"
    code = sum(module.code_lines for module in found)
    if len(found) > FILES_MAX:
        yield f"{len(found)} files, at most {FILES_MAX}"
    if code > CODE_LINES_MAX:
        yield f"{code} lines of code, at most {CODE_LINES_MAX}"


def import_offences(found: list[Module]) -> Iterator[str]:
    """Imports inside functions, and circles between files."""
    inside = [f"{m.path}:{line}" for m in found for line in m.imports_in_functions()]
    if len(inside) > IMPORTS_IN_FUNCTIONS_MAX:
        yield f"{len(inside)} imports inside functions, at most {IMPORTS_IN_FUNCTIONS_MAX}: " + (
            ", ".join(inside)
        )
    graph = grimp.build_graph(PACKAGE, cache_dir=None)
    order = {name: graph.find_modules_directly_imported_by(name) for name in graph.modules}
    try:
        graphlib.TopologicalSorter(order).prepare()
    except graphlib.CycleError as circle:
        yield f"a circle of imports: {' -> '.join(circle.args[1])}"


def root_offences(top: Path) -> Iterator[str]:
    """Python files at the root of the package: only its face."""
    for path in sorted(top.glob("*.py")):
        if path.name != "__init__.py":
            yield f"{path.name}: no module belongs at the root of the package"


def counts(found: list[Module]) -> str:
    """The numbers in one line."""
    lengths = sorted(body_lines(f) for m in found for f in m.functions())
    inside = sum(1 for m in found for _ in m.imports_in_functions())
    return (
        f"{len(found)} files, {sum(m.code_lines for m in found)} lines of code, longest file "
        f"{max(m.lines for m in found)}; {inside} imports inside functions; functions: median "
        f"{statistics.median(lengths):g}, p90 {lengths[len(lengths) * 9 // 10]}, max {lengths[-1]}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--counts", action="store_true", help="print the numbers, too")
    arguments = parser.parse_args()
    top = ROOT / "host" / PACKAGE
    found = modules(top)
    checks = (class_offences(found), size_offences(found), import_offences(found))
    offences = [line for check in (*checks, root_offences(top)) for line in check]
    if arguments.counts:
        print(counts(found))
    print("\n".join(offences) or "structure of the host package: as it should be")
    sys.exit(bool(offences))


if __name__ == "__main__":
    main()
