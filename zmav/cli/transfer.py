"""What ``zmav ftp`` and ``zmav log`` share: one vehicle, the progress of a transfer, sizes a person can read."""

from __future__ import annotations

import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

import click

import zmav
from zmav.cli.common import dump
from zmav.session import SessionSettings

Progress = Callable[[dict[str, Any]], None]


@asynccontextmanager
async def vehicle_of(name: str, fleet: str, settings: SessionSettings) -> AsyncIterator[zmav.Vehicle]:
    """The vehicle of that name, once it has been heard."""
    async with zmav.open(fleet=fleet, settings=settings) as z:
        yield (await z.wait_for(name, timeout=5.0))[0]


def say(as_json: bool, document: dict[str, Any], text: str) -> None:
    """A result: a JSON line for a script, ``text`` for a person."""
    click.echo(dump(document, pretty=False) if as_json else text)


def size(count: float) -> str:
    """Bytes as a person reads them."""
    for unit in ("B", "kB", "MB"):
        if count < 1000.0:
            return f"{count:.0f} {unit}" if unit == "B" else f"{count:.1f} {unit}"
        count /= 1000.0
    return f"{count:.1f} GB"


def shown(as_json: bool) -> Progress | None:
    """Says a transfer's progress on one line of a terminal; None where nobody looks at one."""
    if as_json or not sys.stderr.isatty():
        return None
    return lambda news: click.echo(f"\r{line(news):<78}", nl=False, err=True)


def finished(progress: Progress | None) -> None:
    """End the line of progress."""
    if progress is not None:
        click.echo("\r" + " " * 78 + "\r", nl=False, err=True)


def line(news: dict[str, Any]) -> str:
    """Progress in words."""
    where = "autopilot -> vehicle" if news.get("stage") == "autopilot" else "vehicle <-> here"
    if news.get("waiting_for"):
        return f"waiting for another transfer: {news['waiting_for']}"
    if news.get("checking"):
        return f"{where}: the autopilot takes the checksum"
    if "bytes" not in news:
        return f"{where}: ..."
    whole = news.get("size")
    share = f"{100.0 * news['bytes'] / whole:5.1f} %" if whole else ""
    return f"{where}: {share} {size(news['bytes'])} at {size(news.get('rate', 0))}/s"
