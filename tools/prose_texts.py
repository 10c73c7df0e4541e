"""The texts that people read: pages of the documentation, and strings that the host tool and the
firmware show. Code and names are masked.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

PAGES = ("README.md", "CHANGELOG.md", "docs/**/*.md")
GENERATED = "docs/reference/generated"  # from texts that are checked where they stand
HOST, FIRMWARE, WIRE = "host/tailbeat", "firmware", "wire"
COMMANDS = f"{HOST}/app/cli"
COMMAND_TABLE = f"{COMMANDS}/app.py"
MASK = "§"  # stands for code and for names

# Calls whose strings are no prose, and calls whose strings are shown however short they are.
NO_PROSE = {
    "compile", "search", "match", "fullmatch", "sub", "split", "classes", "style", "props",
    "run_javascript", "add_css", "add_head_html", "add_body_html", "cdef", "execute",
}  # fmt: skip
NO_PROSE_FIELDS = {"was", "renamed", "module", "name", "metavar", "encoding"}
SHOWN = {
    "opt", "arg", "Entry", "BadParameter", "echo", "warn", "keep", "ask", "say", "tell",
    "print_line", "label", "button", "input", "expansion", "tooltip", "notify", "progress_bar",
    "bytes_bar", "lines_of", "need", "titled",
}  # fmt: skip


@dataclass(frozen=True)
class Text:
    """A text, and its first line in the file. A message is one line of the file and has sentences
    of limited length; of a page each line counts."""

    path: str
    line: int
    text: str
    is_message: bool = True

    def line_of(self, offset: int) -> int:
        """The line of the file that has this character."""
        return self.line + (0 if self.is_message else self.text.count("\n", 0, offset))


def texts(root: Path) -> Iterator[Text]:
    """All texts below ``root``."""
    yield from pages(root)
    yield from host_texts(root)
    yield from firmware_texts(root)


def masked(text: str, rules: list[re.Pattern[str]]) -> str:
    """With what matches masked; lines stay lines."""
    for rule in rules:
        text = rule.sub(lambda one: MASK + "\n" * one[0].count("\n"), text)
    return text


PAGE_CODE = [
    re.compile(r"\A---\n.*?\n---\n", re.DOTALL),
    re.compile(r"^([ >]*)(`{3,}|~{3,}).*?^\1\2[`~]*[ ]*$", re.MULTILINE | re.DOTALL),
    re.compile(r"<!--.*?-->|\$\$.*?\$\$", re.DOTALL),
    re.compile(r"(?:\{[\w:-]+\})?(`+)(?!`)(?:(?!\n\n).)+?(?<!`)\1(?!`)", re.DOTALL),
    re.compile(r"\$[^$\n]+\$"),
    re.compile(r"(?<=\])\([^)\s]*\)|(?<=\])\[[^\]]*\]|<[^>\n]*>|https?://\S+"),
    re.compile(r"'tailbeat [^']*'|(?<![\w-])--?[a-z][\w-]*|\b[A-Z][A-Z0-9]*_[A-Z0-9_]+\b"),
    re.compile(r"\b[\w-]+(?:/[\w.-]+)+|\b[\w-]+\.(?:md|py|toml|json|ulg|csv|c|h|def)\b"),
]


def page_files(root: Path) -> Iterator[Path]:
    """Of the documentation."""
    for rule in PAGES:
        for path in sorted(root.glob(rule)):
            if not path.is_relative_to(root / GENERATED):
                yield path


def pages(root: Path) -> Iterator[Text]:
    """The documentation, and the descriptions of the messages on the wire."""
    for path in page_files(root):
        text = masked(path.read_text(encoding="utf-8"), PAGE_CODE)
        yield Text(str(path.relative_to(root)), 1, text, is_message=False)
    for path in sorted((root / WIRE).rglob("*.xml")):
        text = masked(path.read_text(encoding="utf-8"), [*PAGE_MARKS, *PAGE_CODE])
        yield Text(str(path.relative_to(root)), 1, text, is_message=False)


def message_code(root: Path) -> list[re.Pattern[str]]:
    """What is code in a message: quoted words, commands with their options, names."""
    commands = "|".join(map(re.escape, command_names(root))) or "(?!)"
    option, value = r"--?[a-z][\w-]*(?:[ =](?:[A-Z]{3,}\b|\{|[\d.]+|§)\S*)?", r"[A-Z]{4,}\w*|\{\}"
    return [
        re.compile(r"(?<![\w}])'[^'\n]*'(?!\w)|`[^`\n]*`|https?://\S+"),
        re.compile(rf"\btailbeat (?:{commands})\b(?: (?:{option}|{value}))*"),
        re.compile(rf"(?<![\w-]){option}"),
        re.compile(
            r"\b[A-Za-z0-9]+_[A-Za-z0-9_]+\b|\b[\w-]+\.(?:json|toml|ulg|csv|txt|bin|elf|mp4|mkv|dat|html)\b"
        ),
        re.compile(r"\{\}|<[a-z!/][^>]*>"),
    ]


def command_names(root: Path) -> list[str]:
    """``trial run`` and all others, the longest first."""
    path = root / COMMAND_TABLE
    tree = ast.parse(path.read_text(encoding="utf-8")) if path.exists() else ast.Module([], [])
    names = {
        key.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Dict)
        for key in node.keys
        if isinstance(key, ast.Constant) and isinstance(key.value, str)
    }
    return sorted(names, key=len, reverse=True)


def host_texts(root: Path) -> Iterator[Text]:
    """What the host tool shows."""
    rules = message_code(root)
    files = sorted((root / HOST).rglob("*.py"))
    trees = {path: ast.parse(path.read_text(encoding="utf-8")) for path in files}
    shown = SHOWN | error_classes(list(trees.values()))
    for path, tree in trees.items():
        name = str(path.relative_to(root))
        strings = Strings(shown, has_commands=name.startswith(COMMANDS))
        strings.visit(tree)
        for line, text in strings.found:
            yield Text(name, line, masked(text, rules))
    for kind in ("*.toml", "*.js", "*.html"):
        for path in sorted((root / HOST).rglob(kind)):
            yield from quoted_texts(root, path, rules)
            if kind == "*.html":
                text = masked(path.read_text(encoding="utf-8"), [*PAGE_MARKS, *rules])
                yield Text(str(path.relative_to(root)), 1, text, is_message=False)


PAGE_MARKS = [
    re.compile(r"<(style|script)\b.*?</\1>|\{#.*?#\}|\{%.*?%\}|\{\{.*?\}\}", re.DOTALL),
    re.compile(r"<[^>]*>", re.DOTALL),
]


def error_classes(trees: list[ast.Module]) -> set[str]:
    """TailbeatError and all that is derived from it, by name."""
    bases = {
        node.name: {base.id for base in node.bases if isinstance(base, ast.Name)}
        for tree in trees
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef)
    }
    names = {"TailbeatError"}
    while more := {name for name, its in bases.items() if its & names} - names:
        names |= more
    return names


def string_of(node: ast.AST) -> str | None:
    """The text of a string, of an f-string and of a sum of such; what is filled in is ``{}``."""
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else None
    if isinstance(node, ast.JoinedStr):
        return "".join(string_of(part) or "{}" for part in node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        left, right = string_of(node.left), string_of(node.right)
        return None if left is None and right is None else f"{left or '{}'}{right or '{}'}"
    return None


def called(node: ast.AST) -> str:
    """The name of what a call calls; empty for all else."""
    function = node.func if isinstance(node, ast.Call) else None
    if isinstance(function, ast.Attribute):
        return function.attr
    return function.id if isinstance(function, ast.Name) else ""


def docstring_of(node: ast.AST) -> ast.Constant | None:
    """The docstring's node; None where there is none."""
    body = getattr(node, "body", None)
    if isinstance(body, list) and body and isinstance(body[0], ast.Expr):
        value = body[0].value
        return value if isinstance(value, ast.Constant) else None
    return None


def is_prose(text: str) -> bool:
    """Whether a string reads like a text for people: three words or more."""
    words = re.findall(r"(?<![\w.{/<-])[A-Za-z][A-Za-z']+(?![\w(=/>])", text)
    return len(words) >= 3 and " " in text.strip()


class Strings(ast.NodeVisitor):
    """Collects (line, text) of what a module shows: the strings of the calls ``shown``, all others
    that read like prose and, in a module of commands, their docstrings, which are help texts."""

    def __init__(self, shown: set[str], has_commands: bool) -> None:
        self.shown = shown
        self.has_commands = has_commands
        self.found: list[tuple[int, str]] = []
        self._is_shown = False

    def visit(self, node: ast.AST) -> None:
        text = string_of(node)
        if text is None:
            self._visit_parts(node)
            return
        if self._is_shown or is_prose(text):
            self.found.append((getattr(node, "lineno", 1), text))
        for part in ast.walk(node):
            if isinstance(part, ast.FormattedValue):
                self.visit(part.value)

    def _visit_parts(self, node: ast.AST) -> None:
        if isinstance(node, ast.keyword) and node.arg in NO_PROSE_FIELDS:
            return
        docstring, name, before = docstring_of(node), called(node), self._is_shown
        if docstring is not None and self.has_commands and is_command(node):
            self.found.append((docstring.lineno, str(docstring.value)))
        if name:
            self._is_shown = name in self.shown
        for child in ast.iter_child_nodes(node):
            is_comment = isinstance(child, ast.Expr) and string_of(child.value) is not None
            if not is_comment and (name not in NO_PROSE or isinstance(child, ast.Attribute)):
                self.visit(child)
        self._is_shown = before


def is_command(node: ast.AST) -> bool:
    """Whether it is a function that does a command: public, outside a class."""
    return (
        isinstance(node, ast.FunctionDef)
        and node.col_offset == 0
        and not node.name.startswith("_")
        and node.returns is not None
        and ast.unparse(node.returns) in ("Output", "None")
    )


QUOTED = re.compile(r'"((?:[^"\\\n]|\\.)*)"')
C_COMMENT = re.compile(r"/\*.*?\*/|//[^\n]*", re.DOTALL)


def quoted_texts(root: Path, path: Path, rules: list[re.Pattern[str]]) -> Iterator[Text]:
    """What stands between double quotes and reads like prose."""
    content = path.read_text(encoding="utf-8")
    if path.suffix in (".c", ".h", ".def"):
        content = masked(content, [C_COMMENT])
    for number, line in enumerate(content.split("\n"), start=1):
        for one in QUOTED.finditer(line):
            if is_prose(one[1]) or (path.suffix == ".def" and " " in one[1]):
                yield Text(str(path.relative_to(root)), number, masked(one[1], rules))


def firmware_texts(root: Path) -> Iterator[Text]:
    """STATUSTEXTs, and the tables of faults, problems and parameters."""
    rules = message_code(root)
    for kind in ("*.def", "*.c", "*.h"):
        for path in sorted((root / FIRMWARE).rglob(kind)):
            yield from quoted_texts(root, path, rules)
