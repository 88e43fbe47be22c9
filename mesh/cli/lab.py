"""``zmav lab``: a fleet of network namespaces on this machine, with links that are cut and worsened by hand."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import click
import msgspec

from mesh.lab import kernel
from mesh.lab.control import Control, Room
from mesh.lab.lab import Lab
from mesh.lab.network import LabError, check_able
from mesh.lab.remote import Remote, claimed
from mesh.lab.scenario import load_scenario
from mesh.lab.status import tables
from zmav.cli.common import assignments, console, dump, json_option, run
from zmav.errors import BadInput
from zmav.process import until_stopped
from zmav.waiting import alongside


@click.group("lab")
def lab() -> None:
    """A laboratory of network namespaces: 'zmav lab up deploy/labs/line5.toml', then 'zmav lab cut 2-3'.

    Each host has a namespace of its own with its router in it, and vehicles are simulated. Links have delay, loss and
    a rate, set while they run. Needs root. A LINK is two hosts (quad2-quad3, or 2-3), one direction of it (2>3), of
    one medium (wifi:2-3), a medium's name for all in it, or 'all'.
    """


@lab.command("up")
@click.argument("file")
@click.option("--bare", is_flag=True, help="Namespaces and links alone: no routers, no vehicles.")
def up(file: str, bare: bool) -> None:
    """Make a lab, one at a time, and run it until Ctrl-C, SIGTERM or 'zmav lab down'. Nothing of it is left then."""
    check_able()
    scenario = load_scenario(file)
    with claimed(scenario.name) as (directory, claim):
        run(_up(Lab(scenario, directory, programs=not bare, keep=(claim,))))


async def _up(made: Lab) -> None:
    async with alongside(until_stopped()) as (stopped,):  # heard from the first moment on
        async with made, Control(made) as control:
            begun, hosts, links = time.monotonic(), len(made.hosts), len(made.network.wiring.edges)
            click.echo(f"lab {made.scenario.name}: {hosts} hosts, {links} links; files in {made.directory}")
            async with alongside(made.ready(), control.down.wait()) as (ready, asked):
                assert made.failed is not None
                over: set[asyncio.Future[Any]] = {stopped, asked, made.failed}
                await asyncio.wait({*over, ready}, return_when=asyncio.FIRST_COMPLETED)
                if ready.done():
                    ready.result()
                    click.echo(f"up in {time.monotonic() - begun:.1f} s")
                    await asyncio.wait(over, return_when=asyncio.FIRST_COMPLETED)
        if made.failed.done():
            raise LabError(made.failed.result())


@lab.command("status")
@json_option
def status(as_json: bool) -> None:
    """Show hosts and links: state, loss, rate, and what has crossed."""
    with Remote() as remote:
        found = remote.status()
    if as_json:
        click.echo(dump(msgspec.to_builtins(found), pretty=sys.stdout.isatty()))
        return
    console().print(tables(found))


@lab.command("set")
@click.argument("link")
@click.argument("conditions", nargs=-1, required=True)
def set_conditions(link: str, conditions: tuple[str, ...]) -> None:
    """Change a link: 'zmav lab set 2-3 loss=0.2 delay=100ms rate=1M'.

    Also jitter, ordered (true or false), burst (frames lost in a row, on average), queue (bytes that may wait)
    and up. rate=max: no limit.
    """
    with Remote() as remote:
        remote.call("set", link=link, conditions=assignments(conditions))


def _add_order(verb: str, about: str, text: str) -> None:
    @lab.command(verb, help=text)
    @click.argument(about)
    def command(**which: Any) -> None:
        with Remote() as remote:
            remote.call(verb, **which)


_add_order("cut", "link", "Let nothing cross a link any more: 'zmav lab cut 2-3'.")
_add_order("heal", "link", "Undo a cut.")
_add_order("start", "host", "Start a host's router (or 'simulator') again after stop or kill.")
_add_order("stop", "host", "End a host's router in good order.")
_add_order("kill", "host", "End a host's router as if its computer lost power.")


@lab.command("down")
def down() -> None:
    """End a lab; returns when it is gone."""
    with Remote() as remote:
        remote.call("down")
        remote.wait()
        deadline = time.monotonic() + 30.0
        while remote.directory.exists() and time.monotonic() < deadline:
            time.sleep(0.05)


@lab.command("exec", context_settings={"ignore_unknown_options": True, "allow_interspersed_args": False})
@click.argument("host")
@click.argument("command", nargs=-1, required=True, type=click.UNPROCESSED)
def execute(host: str, command: tuple[str, ...]) -> None:
    """Run a program in a host: 'zmav lab exec ground zmav ls', 'zmav lab exec quad1 bash'.

    It has this terminal, the host's network and credentials, and ends with the lab. Its exit code is ours.
    """
    check_able()
    with Remote() as remote:
        room = msgspec.convert(remote.call("room", host=host), Room)
    try:
        processes, namespace = (os.open(path, os.O_RDONLY) for path in (f"/proc/{room.pid}/ns/pid", room.namespace))
    except OSError as e:
        raise LabError(f"the lab has just ended: {e.strerror}") from e
    kernel.setns(processes, kernel.CLONE_NEWPID)  # where everything ends with the relay
    kernel.setns(namespace, kernel.CLONE_NEWNET)
    sys.exit(_run(command, room.environment))


def _run(command: tuple[str, ...], environment: dict[str, str]) -> int:
    """The program's exit code, as a shell gives it."""
    beside = str(Path(sys.executable).parent)  # where this zmav is
    environment = {**os.environ, **environment, "PATH": f"{beside}:{os.environ.get('PATH', os.defpath)}"}
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the terminal tells the program as well, and it decides
    try:
        process = subprocess.Popen(command, env=environment, preexec_fn=_as_a_shell_would)
    except OSError as e:
        raise BadInput(f"cannot run {command[0]!r}: {e.strerror}", field="command", value=command[0]) from e
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda number, _: process.send_signal(number))
    code = process.wait()
    return code if code >= 0 else 128 - code


def _as_a_shell_would() -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    kernel.die_with_parent(signal.SIGKILL)
