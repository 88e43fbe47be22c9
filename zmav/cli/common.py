"""What verbs share: Zenoh's own flags, the fleet, running a coroutine, telling JSON from a person."""

from __future__ import annotations

import contextlib
import functools
import importlib
import itertools
import json
import math
import os
import re
import sys
from collections.abc import Awaitable, Callable, Coroutine, Iterable, Sequence
from importlib.machinery import PathFinder
from pathlib import Path
from types import CodeType
from typing import TYPE_CHECKING, Any, TypeVar

import click
from click.types import FloatParamType

from zmav.errors import BadInput
from zmav.trust import VARIABLE

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

    from rich.console import Console
    from rich.table import Table

    from zmav.client import Client
    from zmav.session import SessionSettings

UNITS = {"": 1.0, "kb": 1e3, "mb": 1e6, "gb": 1e9, "tb": 1e12}
"""of amounts of bytes"""
F = TypeVar("F", bound=Callable[..., Any])
Work = Callable[["Client"], Awaitable[None]]
"""what a verb does with the key space"""


class Verbs(click.Group):
    """Loads a verb only when it is used: ``zmav ls`` need not wait for what the planner imports.

    ``files``: verbs that are each ``command`` in a file of their name in ``package``; ``points``: the group of entry
    points by which packages above the library add theirs.
    """

    def __init__(self, *args: Any, package: str = "", files: Sequence[str] = (), points: str = "", **more: Any) -> None:
        super().__init__(*args, **more)
        self._package, self._files, self._group = package, files, points

    @functools.cached_property
    def _points(self) -> dict[str, EntryPoint]:
        from importlib.metadata import entry_points

        return {point.name: point for point in entry_points(group=self._group)} if self._group else {}

    @functools.cached_property
    def _own(self) -> dict[str, str]:
        """MODULE:NAME of such verbs that are installed with this package. It is read here, because importlib.metadata
        takes 1.6 MB for as long as the program runs, and an agent on a vehicle needs nothing else of it.
        """
        for folder in sys.path if self._group else ():
            with contextlib.suppress(OSError):  # who runs a verb may not be allowed to read all of them
                for file in Path(folder).glob("zmav-*.dist-info/entry_points.txt"):
                    group = file.read_text("utf-8").partition(f"[{self._group}]")[2].partition("[")[0]
                    return dict(line.split(" = ", 1) for line in group.splitlines() if " = " in line)
        return {}

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted({*super().list_commands(ctx), *self._files, *self._points})

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        if name in self._files:
            found = importlib.import_module(f"{self._package}.{name}").command
        elif name in self._own:
            module, _, function = self._own[name].partition(":")
            found = getattr(importlib.import_module(module), function)
        elif name in self._points:
            found = self._points[name].load()
        else:
            return super().get_command(ctx, name)
        assert isinstance(found, click.Command)
        return found

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """What each verb says that it does, without loading those whose compiled files tell."""
        listed = {}
        for name in self.list_commands(ctx):
            about = self.about(name)
            command = self.get_command(ctx, name) if about is None else click.Command(name, help=about)
            if command is not None:
                listed[name] = command
        click.Group(commands=listed).format_commands(ctx, formatter)

    def about(self, name: str) -> str | None:
        """The docstring of a verb's function, found without running its file; None where it is not found so."""
        if name in self._files:
            module, function = f"{self._package}.{name}", "command"
        elif name in self._own or name in self._points:
            module, _, function = (self._own.get(name) or self._points[name].value).partition(":")
        else:
            return None
        path: Sequence[str] | None = None
        code: CodeType | None = None
        for dotted in itertools.accumulate(module.split("."), "{}.{}".format):
            spec = PathFinder.find_spec(dotted, path)
            path = spec.submodule_search_locations if spec else None
            code = spec.loader.get_code(dotted) if spec and dotted == module else None  # type: ignore[union-attr]
        for inner in code.co_consts if code else ():
            if isinstance(inner, CodeType) and inner.co_name == function and isinstance(inner.co_consts[0], str):
                return inner.co_consts[0]
        return None


class Finite(FloatParamType):
    """Numbers, of which NaN and infinity are none."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        found = super().convert(value, param, ctx)
        return found if math.isfinite(found) else self.fail(f"{value!r} is no finite number", param, ctx)


class Between(Finite, click.FloatRange):
    """Such numbers in a range, which NaN would pass: it is neither above nor below any."""


def zenoh_options(command: F) -> F:
    """``-e -l -m -c --cfg`` as the zenoh tools have them, given to the verb as one ``settings``."""

    @click.option(
        "-e",
        "--connect",
        multiple=True,
        metavar="ENDPOINT",
        help="Zenoh endpoint to connect to (repeatable).  [default for clients: $ZMAV_CONNECT, or loopback's router]",
    )
    @click.option("-l", "--listen", multiple=True, metavar="ENDPOINT", help="Zenoh endpoint to listen on (repeatable).")
    @click.option(
        "-m", "--mode", type=click.Choice(["client", "peer", "router"]), help="[default: client, or the file's]"
    )
    @click.option("-c", "--config", metavar="FILE", help="Zenoh configuration file.")
    @click.option("--cfg", multiple=True, metavar="PATH:VALUE", help="One Zenoh configuration value (repeatable).")
    @click.option(
        "--credentials",
        metavar="DIR",
        envvar=VARIABLE,
        show_envvar=True,
        help="Folder of the member we are: see 'zmav mesh ca'.",
    )
    @functools.wraps(command)
    def wrapped(*args: Any, config: str | None, **options: Any) -> Any:
        from zmav.session import SessionSettings

        own = {name: options.pop(name) for name in ("connect", "listen", "mode", "cfg", "credentials")}
        return command(*args, settings=SessionSettings(file=config, **own), **options)

    return wrapped  # type: ignore[return-value]


force_option = click.option(
    "--force", is_flag=True, help="Beyond the usual bounds of a field too, not beyond declared ones."
)
fleet_option = click.option(
    "--fleet",
    default=lambda: os.environ.get("ZMAV_FLEET", "demo"),
    show_default="demo, or $ZMAV_FLEET",
    help="Fleet to look at; '*' for all.",
)
seconds_option = click.option(
    "--for", "seconds", type=Between(min=0.1), default=3.0, show_default=True, help="Seconds to listen."
)
json_option = click.option("--json", "as_json", is_flag=True, help="One JSON document a line, for scripts.")
dialect_option = click.option(
    "--dialect", default="ardupilotmega", show_default=True, help="common, development, or another of pymavlink."
)


def connected(verb: Callable[..., Work]) -> Callable[..., None]:
    """The body of a verb that meets the key space: it looks at its options and gives back what is to be done with an
    open client, before any session is opened. Options of it are ``--fleet`` and Zenoh's own; ``dialect``, where the
    verb has it, is the client's.
    """

    @fleet_option
    @zenoh_options
    @functools.wraps(verb)
    def wrapped(fleet: str, settings: SessionSettings, dialect: str = "ardupilotmega", **options: Any) -> None:
        work = verb(**options)

        async def meet() -> None:
            from zmav.client import connect

            async with connect(fleet=fleet, settings=settings, dialect=dialect) as z:
                await work(z)

        run(meet())

    return wrapped


def run(coroutine: Coroutine[Any, Any, None]) -> None:
    """Run a verb's coroutine; Ctrl-C ends it without a traceback, and so does a reader who has seen enough."""
    import asyncio

    try:
        asyncio.run(coroutine)
    except BrokenPipeError:  # 'zmav echo | head'
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or what is buffered fails again at the exit
        sys.exit(0)


def assignments(pairs: tuple[str, ...]) -> dict[str, Any]:
    """``name=value`` pairs; a value is JSON where it can be, else a string."""
    values: dict[str, Any] = {}
    for pair in pairs:
        name, equals, text = pair.partition("=")
        if not equals or not name:
            raise BadInput(f"{pair!r} is not NAME=VALUE", field=pair, value=pair, expected="NAME=VALUE")
        try:
            values[name] = json.loads(text, parse_int=_whole)
        except (ValueError, RecursionError):
            values[name] = text
    return values


def _whole(digits: str) -> float:
    """Beyond MAVLink's 64 bits it is a float, and may be infinite: what it is for refuses it by its name."""
    number = int(digits) if len(digits) <= 20 else float(digits)
    return number if abs(number) < 1 << 64 else float(number)


def console() -> Console:
    """Where tables go: the terminal's width, or one that holds them where there is no terminal."""
    from rich.console import Console

    return Console(width=None if sys.stdout.isatty() else 120)


def table(columns: Sequence[str], right: Sequence[str] = ()) -> Table:
    """An empty table; the columns named in ``right`` are numbers."""
    from rich.table import Table

    found = Table(box=None, pad_edge=False, header_style="bold")
    for column in columns:
        found.add_column(column, justify="right" if column in right else "left", no_wrap=column != "")
    return found


def show_table(columns: Sequence[str], rows: Iterable[Sequence[str]], right: Sequence[str] = ()) -> None:
    """Print a :func:`table` of these rows."""
    drawn = table(columns, right)
    for row in rows:
        drawn.add_row(*row)
    console().print(drawn, markup=False)


def tell(as_json: bool, document: dict[str, Any], text: str) -> None:
    """A result: a JSON line for a script, ``text`` for a person."""
    click.echo(dump(document) if as_json else text)


def size(count: float) -> str:
    """Bytes as a person reads them."""
    for unit in ("B", "kB", "MB"):
        if count < 1000.0:
            return f"{count:.0f} {unit}" if unit == "B" else f"{count:.1f} {unit}"
        count /= 1000.0
    return f"{count:.1f} GB"


def amount(ctx: click.Context, option: click.Parameter, text: str) -> int:
    """An option's callback that reads bytes with their unit: ``5GB``."""
    found = re.fullmatch(r"([0-9]{1,15}(?:\.[0-9]{1,15})?) *([a-z]*)", text.strip().lower())
    if found is None or found[2] not in UNITS:
        raise click.BadParameter(f"{text!r} is not a number with its unit, as in 1GB", ctx, option)
    return int(float(found[1]) * UNITS[found[2]])


def dump(value: Any, *, pretty: bool = False) -> str:
    """JSON for a person or for a script."""
    return json.dumps(value, indent=2 if pretty else None, ensure_ascii=False, default=str)
