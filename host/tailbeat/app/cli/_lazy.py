"""Commands of which only the line in the table is known until one is run or its help is asked."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextvars import ContextVar
from dataclasses import dataclass, fields, is_dataclass
from functools import cached_property, wraps
from importlib import import_module
from inspect import Parameter, signature
from itertools import groupby
from types import MappingProxyType
from typing import Any, get_type_hints

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from tailbeat.core.extras import need

PACKAGE = "tailbeat.app.cli"
_NONE: Mapping[str, str] = MappingProxyType({})

typed_words: ContextVar[tuple[str, ...]] = ContextVar("typed_words", default=())


@dataclass(frozen=True)
class Entry:
    """One line of the table. ``target``: module:function in this package; empty for a group, whose
    ``default`` names the command that runs when none is named. ``needs``: arguments of
    core.extras.need for a command that an extra brings."""

    help: str
    target: str = ""
    panel: str = "Commands"
    default: str = ""
    needs: tuple[str, str, str] | None = None
    settings: Mapping[str, Any] | None = None

    def load(self) -> Callable[..., None]:
        """The function that does it; imports its module."""
        if self.needs is not None:
            need(*self.needs)
        module, _, name = self.target.partition(":")
        function: Callable[..., None] = getattr(import_module(f"{PACKAGE}.{module}"), name)
        return function


def unbundled(function: Callable[..., None]) -> Callable[..., None]:
    """The same command for Typer: each option bundle, a dataclass whose fields are options, is
    replaced by its fields."""
    hints = get_type_hints(function, include_extras=True)
    bundles: dict[str, Any] = {name: hint for name, hint in hints.items() if is_dataclass(hint)}
    flat: dict[str, Parameter] = {}
    for name, parameter in signature(function).parameters.items():
        if name not in bundles:
            flat[name] = parameter.replace(annotation=hints[name], kind=Parameter.KEYWORD_ONLY)
            continue
        known = get_type_hints(bundles[name], include_extras=True)
        for field in fields(bundles[name]):
            flat[field.name] = Parameter(
                field.name, Parameter.KEYWORD_ONLY, default=field.default,
                annotation=known[field.name],
            )  # fmt: skip

    @wraps(function)
    def call(**given: Any) -> None:
        for name, bundle in bundles.items():
            given[name] = bundle(**{field.name: given.pop(field.name) for field in fields(bundle)})
        function(**given)

    call.__signature__ = signature(call).replace(parameters=[*flat.values()])  # type: ignore[attr-defined]
    call.__annotations__ = {name: one.annotation for name, one in flat.items()}
    del call.__wrapped__
    return call


class LazyCommand(TyperCommand):
    """Stands for a command in lists; becomes it when it is called, or its help is asked.
    ``options``: old spellings of its options, to the new ones."""

    def __init__(
        self, name: str, entry: Entry, hidden: bool = False, options: Mapping[str, str] = _NONE
    ) -> None:
        super().__init__(name, short_help=entry.help, hidden=hidden, rich_markup_mode=None)
        self.entry, self._options = entry, options

    @cached_property
    def loaded(self) -> Any:
        """The command itself."""
        alone = typer.Typer(add_completion=False, rich_markup_mode=None)
        settings = dict(self.entry.settings or {})
        alone.command(self.name, context_settings=settings)(unbundled(self.entry.load()))
        return get_command(alone)

    def make_context(
        self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any
    ) -> Any:
        """That of the command itself."""
        return self.loaded.make_context(info_name, [*map(self._now, args)], parent, **extra)

    def _now(self, word: str) -> str:
        option, equals, value = word.partition("=")
        return self._options.get(option, option) + equals + value


class LazyGroup(TyperGroup):
    """A group of such commands, listed by panel."""

    entry: Entry | None = None

    @classmethod
    def of(cls, name: str, entry: Entry, hidden: bool = False) -> LazyGroup:
        """A group without commands yet."""
        default = f"\n\nWithout a command it runs '{entry.default}'; see '{name} {entry.default}"
        default = f"{default} --help'." if entry.default else ""
        group = cls(
            name=name,
            help=f"{entry.help}.{default}",
            short_help=entry.help,
            hidden=hidden,
            no_args_is_help=not entry.default,
            rich_markup_mode=None,
        )
        group.entry = entry
        return group

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Puts in the default command's name where options or nothing follow."""
        default = self.entry.default if self.entry else ""
        options = args[:1] != ["--help"] and all(word.startswith("-") for word in args[:1])
        if default and options and (args or not ctx.resilient_parsing):
            args = [default, *args]
        return super().parse_args(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """One list for each panel, in the order of the table."""
        listed: list[Any] = [one for one in self.commands.values() if not one.hidden]
        width = max(len(one.name) for one in listed)
        for panel, some in groupby(listed, key=lambda one: one.entry.panel):
            with formatter.section(panel):
                formatter.write_dl([(one.name.ljust(width), one.short_help) for one in some])


def grow(
    root: TyperGroup,
    groups: Mapping[str, Entry],
    commands: Mapping[str, Entry],
    renamed: Mapping[str, str],
    options: Mapping[str, Mapping[str, str]],
) -> None:
    """Hangs the table's commands below ``root``, and hidden ones under the old names."""
    for path, entry in commands.items():
        _hang(root, path, entry, groups, options.get(path, {}))
    for old, path, entry in aliases(commands, renamed):
        _hang(root, old, entry, groups, options.get(path, {}), renamed)


def aliases(
    commands: Mapping[str, Entry], renamed: Mapping[str, str]
) -> Iterable[tuple[str, str, Entry]]:
    """(old path, new path, entry) of each command that has an old name; a group's name stands for
    all its commands."""
    for old, new in renamed.items():
        for path, entry in commands.items():
            if path == new or path.startswith(f"{new} "):
                yield old + path.removeprefix(new), path, entry


def _hang(
    root: TyperGroup,
    path: str,
    entry: Entry,
    groups: Mapping[str, Entry],
    options: Mapping[str, str],
    renamed: Mapping[str, str] | None = None,
) -> None:
    """``renamed``: the path is an old one."""
    *above, name = path.split()
    here = root
    for depth, word in enumerate(above, start=1):
        if word not in here.commands:
            path_here = " ".join(above[:depth])
            known = path_here if renamed is None else renamed.get(path_here, path_here)
            group = LazyGroup.of(word, groups.get(known, Entry("Old names")), renamed is not None)
            here.add_command(group)
        below: Any = here.commands[word]
        here = below
    if name not in here.commands:
        here.add_command(LazyCommand(name, entry, renamed is not None, options))
