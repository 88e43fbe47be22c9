"""What verbs share: Zenoh's own flags, the fleet, running a coroutine, telling JSON from a person."""

from __future__ import annotations

import asyncio
import functools
import json
import os
import sys
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

import click
from rich.console import Console

from zmav.errors import BadInput
from zmav.session import Mode, SessionSettings
from zmav.trust.credentials import VARIABLE

F = TypeVar("F", bound=Callable[..., Any])


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
    def wrapped(
        *args: Any,
        connect: tuple[str, ...],
        listen: tuple[str, ...],
        mode: Mode | None,
        config: str | None,
        cfg: tuple[str, ...],
        credentials: str | None,
        **kwargs: Any,
    ) -> Any:
        settings = SessionSettings(
            mode=mode, connect=connect, listen=listen, file=config, cfg=cfg, credentials=credentials
        )
        return command(*args, settings=settings, **kwargs)

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
    "--for", "seconds", type=click.FloatRange(min=0.1), default=3.0, show_default=True, help="Seconds to listen."
)
json_option = click.option("--json", "as_json", is_flag=True, help="One JSON document a line, for scripts.")


def run(coroutine: Coroutine[Any, Any, None]) -> None:
    """Run a verb's coroutine; Ctrl-C ends it without a traceback, and so does a reader who has seen enough."""
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
            values[name] = json.loads(text)
        except json.JSONDecodeError:
            values[name] = text
    return values


def console() -> Console:
    """Where tables go: the terminal's width, or one that holds them where there is no terminal."""
    return Console(width=None if sys.stdout.isatty() else 120)


def dump(value: Any, *, pretty: bool) -> str:
    """JSON for a person or for a script."""
    return json.dumps(value, indent=2 if pretty else None, ensure_ascii=False, default=str)
