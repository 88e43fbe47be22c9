"""How a process that runs a router lives: until it is asked to end, or its router is out of date."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable

import click

from mesh.plan import RouterPlan
from mesh.router import Router
from zmav.process import until_stopped

LOOK_S = 0.5


async def until_outdated(router: Router, line: str, idle: Callable[[], bool] = lambda: True) -> str | None:
    """Return None when the process is asked to end, or why its router is to be opened anew, as soon as it is ``idle``.

    ``line`` is said once it can be asked to end; then, which radios are waited for. Run in the main thread.
    """
    stopped, outdated = asyncio.ensure_future(until_stopped()), asyncio.ensure_future(_outdated(router, idle))
    try:
        await asyncio.sleep(0)  # the tasks begin
        click.echo(line, err=True)
        _say_waiting(router.plan)
        await asyncio.wait((stopped, outdated), return_when=asyncio.FIRST_COMPLETED)
        return None if stopped.done() else outdated.result()
    finally:
        for task in (stopped, outdated):
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task


async def _outdated(router: Router, idle: Callable[[], bool]) -> str:
    why = await router.outdated()
    if not idle():
        click.echo(f"{why}: starting anew as soon as the vehicle is disarmed and nobody commands it", err=True)
        while not idle():
            await asyncio.sleep(LOOK_S)
    return why


def _say_waiting(plan: RouterPlan) -> None:
    """A line for each radio that is not there yet."""
    for radio in plan.radios:
        if not radio.present:
            what = f"has not the address {radio.address.ip}" if radio.address else "is not there or has no address"
            click.echo(f"{radio.name} {what} yet: waiting for it", err=True)
