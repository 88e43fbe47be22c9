"""The camera that the autopilot triggers by distance, and its end with the lease under which that was asked for."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from typing import Any

from zmav import wire
from zmav.autopilots import Command
from zmav.errors import BadInput, LinkError, Refused, Stale, TimedOut, ZmavError
from zmav.services.companion import Companion
from zmav.services.orders.command import Commander
from zmav.services.orders.orders import Report

DISTANCES = (0.1, 1000.0)
"""m between two pictures"""
AGAIN = 1.0
"""s between two tries to stop a camera where the autopilot does not answer"""


class TriggeredCamera:
    """Handler of ``camera_trigger``. Lives on the event loop.

    What was switched on under a lease is switched off when that lease ends, by anybody: the pilot, an operator's
    hold, a planner that died. Without a lease it goes on until somebody says 0. ``param``: the autopilot's parameter
    of that name, if known.
    """

    def __init__(self, companion: Companion, commander: Commander, param: Callable[[str], float | None]) -> None:
        self._port, self._events = companion.port, companion.events
        self._do, self._param = commander, param
        self._leased = False
        """it is on, or may be, under the lease in force"""
        self._latest: wire.CameraTrigger | None = None
        """the order that came last under the lease in force"""
        self._ending: asyncio.Task[None] | None = None

    def start(self) -> None:
        self._port.bus.on(wire.LeaseEnd, self._on_lease_end)

    def close(self) -> None:
        """End; a camera that is on under a lease, or is being stopped after one, is told to stop, once: nobody waits
        for the answer.
        """
        ending = self._ending is not None and self._ending.cancel()
        if self._leased or ending:
            with contextlib.suppress(ZmavError):
                message = _every(0.0).message(self._port.dialect)
                self._port.send(message.name, **message.addressed(*self._do.source()))

    async def trigger(self, args: wire.CameraTrigger, report: Report) -> dict[str, Any]:
        """A picture now and every ``distance`` metres; 0: no more. Raises :class:`Refused` where the autopilot has no
        camera, which ArduPilot does not say by itself.
        """
        low, high = DISTANCES
        if args.distance != 0.0 and not low <= args.distance <= high:
            raise BadInput.wrong("distance", args.distance, f"{low:g} to {high:g} m, or 0")
        kinds = {name: self._param(name) for name in self._do.autopilot().camera_params}
        if kinds and set(kinds.values()) <= {0.0, None} and 0.0 in kinds.values():
            first = next(iter(kinds))
            text = f"the autopilot has no camera: {first} is 0; set it, and restart the autopilot"
            raise Refused(text, vehicle=self._port.name, param=first)
        ending = self._ending is not None and self._ending.cancel()
        on, self._latest = bool(args.lease) and args.distance > 0.0, args
        # One that is not seen to stop is told so once more when the lease ends.
        self._leased = self._leased or ending or on
        await self._do.command(_every(args.distance), report)
        if self._latest is args:
            self._leased = on
        return {"distance": args.distance}

    def _on_lease_end(self, told: wire.LeaseEnd) -> None:
        self._latest = None
        if self._leased:
            self._leased = False
            self._ending = asyncio.get_running_loop().create_task(self._end())

    async def _end(self) -> None:
        """Behind one that may be under way: commands of one name wait for each other. An autopilot that is silent is
        told when it is heard again.
        """
        warned = False
        while True:
            try:
                await self._do.command(_every(0.0))
                return
            except (Stale, TimedOut, LinkError) as e:
                if not warned:
                    self._warn(f"{e.message}; it is tried again until the autopilot answers")
                warned = True
            except ZmavError as e:
                self._warn(e.message)
                return
            await asyncio.sleep(AGAIN)

    def _warn(self, why: str) -> None:
        text = f"the lease has ended, and the camera could not be stopped: {why}"
        self._events.emit("camera", "warning", text)


def _every(metres: float) -> Command:
    """MAV_CMD_DO_SET_CAM_TRIGG_DIST, with a picture at once where it begins."""
    return Command("MAV_CMD_DO_SET_CAM_TRIGG_DIST", (metres, 0.0, float(metres > 0.0)))
