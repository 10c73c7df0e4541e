"""Commands of which only the line in the table is known until one is run or its help is asked."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from copy import copy
from dataclasses import dataclass, fields, is_dataclass
from functools import cached_property, wraps
from importlib import import_module
from inspect import Parameter, signature
from itertools import groupby
from types import MappingProxyType, NoneType
from typing import Annotated, Any, get_args, get_type_hints

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command
from typer.models import ArgumentInfo, OptionInfo

from tailbeat.app.cli._terminal import Output, json_asked, present
from tailbeat.core.extras import need

PACKAGE = "tailbeat.app.cli"
_NONE: Mapping[str, str] = MappingProxyType({})


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

    def load(self) -> Callable[..., Output | None]:
        """The function that does it; imports its module."""
        if self.needs is not None:
            need(*self.needs)
        module, _, name = self.target.partition(":")
        function: Callable[..., Output | None] = getattr(import_module(f"{PACKAGE}.{module}"), name)
        return function


def opt(
    help: str, metavar: str | None = None, name: str = "", default: Any = None, **settings: Any
) -> Any:
    """An option, as a parameter's default or within Annotated. Its name is the parameter's, unless
    it has another one or two (``--x/--no-x``)."""
    names = [name] if name else []
    return typer.Option(default, *names, help=help, metavar=metavar, **settings)


def arg(help: str = "", metavar: str | None = None, default: Any = None, **settings: Any) -> Any:
    """A positional argument, as ``opt``."""
    return typer.Argument(default, help=help or None, metavar=metavar, **settings)


JSON = Annotated[bool, opt("Print one JSON document, nothing else.")]


def command_of(function: Callable[..., Output | None]) -> Callable[..., None]:
    """The same command for Typer. An option bundle, a dataclass whose fields are options, is
    replaced by its fields; for ``Annotated[T, Bundle]`` the command gets what ``Bundle.open()``
    gives for the length of the call. Every command has --json."""
    hints = get_type_hints(function, include_extras=True)
    del hints["return"]
    bundles = {name: found for name, hint in hints.items() if (found := _bundle(hint))}
    own: list[Parameter] = []
    last: list[Parameter] = []  # options that stand at the end, as --connect and --json
    for name, parameter in signature(function).parameters.items():
        if name not in bundles:
            own.append(_parameter(name, hints[name], parameter.default))
            continue
        known = get_type_hints(bundles[name], include_extras=True)
        options = [_parameter(f.name, known[f.name], f.default) for f in fields(bundles[name])]
        (own if is_dataclass(hints[name]) else last).extend(options)
    last.append(_parameter("json", JSON, False))

    @wraps(function)
    def call(**given: Any) -> None:
        json_asked.set(given.pop("json"))
        with ExitStack() as stack:
            for name, bundle in bundles.items():
                made: Any = bundle(**{f.name: given.pop(f.name) for f in fields(bundle)})
                opens = not is_dataclass(hints[name])
                given[name] = stack.enter_context(made.open()) if opens else made
            output = function(**given)
        if output is not None:
            present(output)

    parameters = [*own, *last]
    call.__signature__ = signature(call).replace(parameters=parameters)  # type: ignore[attr-defined]
    call.__annotations__ = {one.name: one.annotation for one in parameters}
    del call.__wrapped__
    return call


def _bundle(hint: Any) -> Any:
    """The option bundle that a parameter stands for."""
    candidates = (hint, *getattr(hint, "__metadata__", ()))
    return next((one for one in candidates if isinstance(one, type) and is_dataclass(one)), None)


def _parameter(name: str, hint: Any, default: Any) -> Parameter:
    """An option without a name gets the parameter's; a switch has no --no-NAME. One without a
    default must be given, unless it may be None."""
    if isinstance(default, OptionInfo | ArgumentInfo):
        info, default = copy(default), default.default
    else:
        hint, info = hint.__origin__, copy(hint.__metadata__[0])
    info.default = ...
    if isinstance(info, OptionInfo):
        info.param_decls = info.param_decls or (f"--{name.rstrip('_').replace('_', '-')}",)
    if default is None and NoneType not in get_args(hint):
        default = False if hint is bool else Parameter.empty
    annotation = Annotated[hint, info]
    return Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


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
        alone.command(self.name, context_settings=settings)(command_of(self.entry.load()))
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
