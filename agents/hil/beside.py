"""``zmav up`` as the vehicle itself runs it, from its fleet file, but with another link and on loopback alone."""

from __future__ import annotations

import asyncio
import contextlib
import os
import time
from collections.abc import AsyncIterator, Iterator
from importlib.metadata import version
from pathlib import Path

import click

import zmav
from agents.hil.report import Check, Report, Stage, hash_of, keep
from zmav.children import Children, connect_once_up
from zmav.config import FleetConfig
from zmav.doctor.link import examine_device
from zmav.errors import BadConfig, ZmavError
from zmav.process import free_port

COLOURS = {"ok": "green", "BAD": "red", "left out": "yellow"}


@contextlib.asynccontextmanager
async def beside(
    children: Children, path: Path, file: FleetConfig, name: str, link: str
) -> AsyncIterator[tuple[zmav.Client, str]]:
    """While it lasts ``zmav up`` runs; gives a client of it, and the endpoint where its router is."""
    router = f"tcp/127.0.0.1:{free_port()}"
    what = ["--file", str(path), "--name", name, "--link", link, "--cache", str(children.folder / "cache")]
    alone = ["-l", router, "--cfg", "connect/endpoints:[]", "--cfg", "scouting/multicast/enabled:false"]
    children.start("up", "up", *what, *alone)
    try:
        async with contextlib.AsyncExitStack() as stack:
            yield await connect_once_up(stack, file.fleet, router, children.check), router
    finally:
        await asyncio.to_thread(children.end, "up")


def begun(stage: Stage, file: FleetConfig, name: str, flown_by: str) -> Report:
    """A report of which nothing has been flown yet."""
    return Report(
        stage=stage,
        fleet=file.fleet,
        vehicle=name,
        fleet_hash=hash_of(file, name),
        zmav=version("zmav"),
        t=time.time(),
        flown_by=flown_by,
    )


def tell(check: Check) -> None:
    """A line on standard output, as it is found."""
    mark = click.style(f"{check.status:<8}", fg=COLOURS[check.status], bold=check.status == "BAD")
    click.echo(f"{mark} {check.name}: {check.found}")


@contextlib.contextmanager
def closing(report: Report, folder: Path) -> Iterator[None]:
    """A stage: whatever ends it, the report is kept, and says why; a :class:`ZmavError` is a line of it."""
    try:
        yield
    except ZmavError as e:
        report.checks.append(Check("stage", "BAD", e.message))
        tell(report.checks[-1])
    except BaseException as e:
        why = "it was interrupted" if isinstance(e, asyncio.CancelledError) else repr(e)
        report.checks.append(Check("stage", "BAD", why))
        tell(report.checks[-1])
        raise
    finally:
        report.passed = bool(report.checks) and all(check.status != "BAD" for check in report.checks)
        path = keep(report, folder)
        click.echo(f"{'PASSED' if report.passed else 'NOT PASSED'}: {path}")


def check_device(link: str) -> None:
    """Raise :class:`BadConfig` for a serial device that is not there, is none, or is not ours to open."""
    for finding in examine_device(link, "root" if os.geteuid() == 0 else None)[:2]:  # what it is, and whose
        if not finding.ok:
            text = f"{finding.found}: {finding.advice}"
            raise BadConfig(text, field="device", value=link, expected="a serial device that you may open")
