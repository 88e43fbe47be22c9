"""What verbs share: Zenoh's own flags, the fleet, running a coroutine, telling JSON from a person."""

from __future__ import annotations

import asyncio
import functools
import json
import os
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

import click

from zmav.errors import BadInput
from zmav.session import Mode, SessionSettings

F = TypeVar("F", bound=Callable[..., Any])


def zenoh_options(command: F) -> F:
    """``-e -l -m -c --cfg`` as the zenoh tools have them, given to the verb as one ``settings``."""

    @click.option(
        "-e", "--connect", multiple=True, metavar="ENDPOINT", help="Zenoh endpoint to connect to (repeatable)."
    )
    @click.option("-l", "--listen", multiple=True, metavar="ENDPOINT", help="Zenoh endpoint to listen on (repeatable).")
    @click.option("-m", "--mode", type=click.Choice(["client", "peer", "router"]), default="client", show_default=True)
    @click.option("-c", "--config", metavar="FILE", help="Zenoh configuration file.")
    @click.option("--cfg", multiple=True, metavar="PATH:VALUE", help="One Zenoh configuration value (repeatable).")
    @functools.wraps(command)
    def wrapped(
        *args: Any, connect: tuple[str, ...], listen: tuple[str, ...], mode: Mode, config: str | None,
        cfg: tuple[str, ...], **kwargs: Any,
    ) -> Any:  # fmt: skip
        settings = SessionSettings(mode=mode, connect=connect, listen=listen, file=config, cfg=cfg)
        return command(*args, settings=settings, **kwargs)

    return wrapped  # type: ignore[return-value]


fleet_option = click.option(
    "--fleet", default=lambda: os.environ.get("ZMAV_FLEET", "demo"), show_default="demo, or $ZMAV_FLEET",
    help="Fleet to look at; '*' for all.",
)  # fmt: skip
json_option = click.option("--json", "as_json", is_flag=True, help="One JSON document a line, for scripts.")


def run(coroutine: Coroutine[Any, Any, None]) -> None:
    """Run a verb's coroutine; Ctrl-C ends it without a traceback."""
    asyncio.run(coroutine)


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


def dump(value: Any, *, pretty: bool) -> str:
    """JSON for a person or for a script."""
    return json.dumps(value, indent=2 if pretty else None, ensure_ascii=False, default=str)
