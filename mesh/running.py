"""How a process that runs a router lives: until it is asked to end, or its router is out of date."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from mesh.plan import RouterPlan
from mesh.router import Router
from zmav import systemd
from zmav.errors import ZmavError
from zmav.process import log, until_stopped
from zmav.waiting import alongside


async def until_outdated(
    router: Router, line: str, plan: Callable[[], object], idle: Callable[[], bool] = lambda: True, pace: float = 1.0
) -> str | None:
    """Return None when the process is asked to end, or why its router is to be opened again, as soon as it is ``idle``.

    ``line`` is said once it can be asked to end, to systemd as well; then, which radios are waited for. ``plan`` plans
    as the process will when it starts again: where that raises :class:`ZmavError` (a fleet file that was changed, a
    certificate that expired since), it goes on as it is and looks again after ``pace`` seconds. Run in the main thread.
    """
    async with alongside(until_stopped(), _outdated(router, plan, idle, pace)) as (stopped, outdated):
        await asyncio.sleep(0)  # the tasks begin
        log(line)
        systemd.notify("READY=1", f"STATUS={line}")
        _say_waiting(router.plan)
        await asyncio.wait((stopped, outdated), return_when=asyncio.FIRST_COMPLETED)
        if stopped.done():
            systemd.notify("STOPPING=1")
            return None
        why: str = outdated.result()
        systemd.notify(f"STATUS=starting again: {why}")
        return why


async def _outdated(router: Router, plan: Callable[[], object], idle: Callable[[], bool], pace: float) -> str:
    why, said = await router.outdated(), ""
    while True:
        if not idle():
            log(f"{why}: starting again as soon as the vehicle is disarmed and nobody commands it")
            while not idle():
                await asyncio.sleep(pace / 2)
        try:
            await asyncio.to_thread(plan)
        except ZmavError as e:
            if said != str(e):
                said = str(e)
                log(f"{why}, but this could not start again: {said}")
            await asyncio.sleep(pace)
            continue
        if idle():
            return why


def _say_waiting(plan: RouterPlan) -> None:
    """A line for each radio that is not there yet."""
    for radio in plan.radios:
        if not radio.present:
            what = f"has not the address {radio.address.ip}" if radio.address else "is not there or has no address"
            log(f"{radio.name} {what} yet: waiting for it")
