"""Commands of which only the line in the table is known until one is run or its help is asked."""

from __future__ import annotations

import gc
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from copy import copy
from dataclasses import dataclass, fields, is_dataclass
from functools import cached_property, wraps
from importlib import import_module
from inspect import Parameter, signature
from itertools import groupby
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command
from typer.models import ArgumentInfo, OptionInfo

from tailbeat.app.cli._terminal import Output, json_asked, present
from tailbeat.core.extras import need

PACKAGE = "tailbeat.app.cli"
_GC_OBJECTS = 50_000  # new ones, after which garbage is looked for; a report makes a million


@dataclass(frozen=True)
class Entry:
    """One line of the table. ``default``: of a group, the command that runs when none is named.
    ``module``: of this package, that has it; default: named as its group.
    ``was``: an old name, hidden until 1.0; a group's stands for all its commands. ``renamed``: the
    old spelling of an option, and the new one. ``needs``: arguments of core.extras.need for a
    command that an extra brings."""

    help: str
    panel: str = "Commands"
    default: str = ""
    module: str = ""
    was: str = ""
    renamed: tuple[str, str] = ("", "")
    needs: tuple[str, str, str] | None = None
    settings: Mapping[str, Any] | None = None

    def load(self, path: str) -> Callable[..., Output | None]:
        """The function that does the command ``path``; imports its module. One that would have a
        name of Python's has an underscore behind it."""
        if self.needs is not None:
            need(*self.needs)
        *groups, name = path.split()
        names = vars(import_module(f"{PACKAGE}.{self.module or groups[-1]}"))
        function: Callable[..., Output | None] = names.get(f"{name}_") or names[name]
        return function


def opt(help: str, metavar: str | None = None, name: str = "", **settings: Any) -> Any:
    """An option, as a parameter's default or within Annotated. Its name is the parameter's, unless
    it has another one or two (``--x/--no-x``). The command gets what ``by`` makes of each word or
    path that is typed, made as the command begins and before a bundle is opened."""
    names = (name,) if name else ()
    return _declared(typer.Option, *names, help=help, metavar=metavar, **settings)


def arg(help: str = "", metavar: str | None = None, **settings: Any) -> Any:
    """A positional argument, as ``opt``."""
    return _declared(typer.Argument, help=help or None, metavar=metavar, **settings)


def _declared(
    kind: Callable[..., Any],
    *names: str,
    default: Any = None,
    by: Callable[[Any], Any] | None = None,
    **settings: Any,
) -> Any:
    info = kind(default, *names, **settings)
    info.by = by
    return info


JSON = Annotated[bool, opt("Print one JSON document, nothing else.")]


def command_of(function: Callable[..., Output | None]) -> Callable[..., None]:
    """The same command for Typer. An option bundle, a dataclass whose fields are options, is
    replaced by its fields; for ``Annotated[T, Bundle]`` the command gets what ``Bundle.open()``
    gives for the length of the call. Every command has --json."""
    hints = get_type_hints(function, include_extras=True)
    del hints["return"]
    defaults = {one.name: one.default for one in signature(function).parameters.values()}
    bundles = {
        name: found
        for name, default in defaults.items()
        if default is Parameter.empty and (found := _bundle(hints[name]))
    }
    own: list[Parameter] = []
    last: list[Parameter] = []  # options that stand at the end, as --connect and --json
    for name, default in defaults.items():
        if name not in bundles:
            own.append(_parameter(name, hints[name], default))
            continue
        known = get_type_hints(bundles[name], include_extras=True)
        options = [_parameter(f.name, known[f.name], f.default) for f in fields(bundles[name])]
        (own if is_dataclass(hints[name]) else last).extend(options)
    parameters = [*own, *last, _parameter("json", JSON, False)]
    makers = {one.name: one.annotation.__metadata__[0].by for one in parameters}

    @wraps(function)
    def call(**given: Any) -> None:
        gc.set_threshold(_GC_OBJECTS)
        gc.enable()
        json_asked.set(given.pop("json"))
        given = {name: _made(makers[name], typed) for name, typed in given.items()}
        with ExitStack() as stack:
            for name, bundle in bundles.items():
                made: Any = bundle(**{f.name: given.pop(f.name) for f in fields(bundle)})
                opens = not is_dataclass(hints[name])
                given[name] = stack.enter_context(made.open()) if opens else made
            output = function(**given)
        if output is not None:
            present(output)

    call.__signature__ = signature(call).replace(parameters=parameters)  # type: ignore[attr-defined]
    call.__annotations__ = {one.name: one.annotation for one in parameters}
    del call.__wrapped__
    return call


def _bundle(hint: Any) -> Any:
    """The option bundle that a parameter stands for."""
    candidates = (hint, *getattr(hint, "__metadata__", ()))
    return next((one for one in candidates if isinstance(one, type) and is_dataclass(one)), None)


def _made(by: Callable[[Any], Any] | None, typed: Any) -> Any:
    if by is None or typed is None:
        return typed
    return [*map(by, typed)] if isinstance(typed, list) else by(typed)


def _typed(hint: Any, by: Callable[[Any], Any]) -> Any:
    """The type of what is typed, for that of what is made of it."""
    kind: Any = next(iter(get_type_hints(by).values()))
    if any(get_origin(one) is list for one in (hint, *get_args(hint))):
        kind = list[kind]
    return kind | None if NoneType in get_args(hint) else kind


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
    by = info.by  # type: ignore[union-attr]
    kind: Any = Annotated[_typed(hint, by) if by else hint, info]
    return Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=kind)


def _quick(kind: Any, value: Any) -> Any:
    """What Typer makes of a value that needs no thought: defaults, texts, and paths, which nothing
    looks at yet. None for any other."""
    if type(value) is kind or (kind is Path and isinstance(value, str | Path)):
        return kind(value)
    if get_origin(kind) is not list or not isinstance(value, list | tuple):
        return None
    made = [_quick(get_args(kind)[0], one) for one in value]
    return None if None in made else made


def _convert_quickly(parameter: Any) -> None:
    """What is left to Typer makes it load pydantic, in 60 ms."""
    thorough = parameter.process_value
    kind = getattr(getattr(parameter, "type_descriptor", None), "annotation", None)

    def process(context: Any, value: Any) -> Any:
        made = () if value is None and parameter.multiple else _quick(kind, value)
        if made in (None, (), []) and (value is not None or parameter.required):
            return thorough(context, value)
        return made if parameter.callback is None else parameter.callback(context, parameter, made)

    if "process_value" not in vars(parameter):
        parameter.process_value = process


class QuickCommand(TyperCommand):
    """A command whose options are converted quickly."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """As its parent."""
        for parameter in self.get_params(ctx):
            _convert_quickly(parameter)
        return super().parse_args(ctx, args)


class LazyCommand(TyperCommand):
    """Stands for a command in lists; becomes it when it is called, or its help is asked."""

    def __init__(self, name: str, path: str, entry: Entry, hidden: bool = False) -> None:
        super().__init__(name, short_help=entry.help, hidden=hidden, rich_markup_mode=None)
        self.path, self.entry = path, entry

    @cached_property
    def loaded(self) -> Any:
        """The command itself."""
        alone = typer.Typer(add_completion=False, rich_markup_mode=None)
        function = command_of(self.entry.load(self.path))
        settings = dict(self.entry.settings or {})
        alone.command(self.name, cls=QuickCommand, context_settings=settings)(function)
        return get_command(alone)

    def make_context(
        self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any
    ) -> Any:
        """That of the command itself."""
        return self.loaded.make_context(info_name, [*map(self._now, args)], parent, **extra)

    def _now(self, word: str) -> str:
        option, equals, value = word.partition("=")
        old, new = self.entry.renamed
        return (new if option == old else option) + equals + value


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
        for parameter in self.get_params(ctx):
            _convert_quickly(parameter)
        return super().parse_args(ctx, args)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """One list for each panel, in the order of the table."""
        listed: list[Any] = [one for one in self.commands.values() if not one.hidden]
        width = max(len(one.name) for one in listed)
        for panel, some in groupby(listed, key=lambda one: one.entry.panel):
            with formatter.section(panel):
                formatter.write_dl([(one.name.ljust(width), one.short_help) for one in some])
