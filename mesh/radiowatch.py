"""Sees a host's radios come and change: what was planned without them is then out of date."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable

import zenoh

from mesh.plan import RouterPlan, is_rendezvous
from mesh.profiles import PROFILES
from mesh.radios import FoundRadio, Interfaces, interfaces

PERIOD_S = 1.0


class RadioWatch:
    """Compares the radios of a plan with what there is, every ``period`` seconds."""

    def __init__(self, plan: RouterPlan, look: Callable[[], Interfaces] = interfaces, period: float = PERIOD_S) -> None:
        self._plan, self._radios, self._look, self._period = plan, plan.radios, look, period
        self._scouts = PROFILES[plan.profile].scouting and plan.host.neighbours is None
        self._gone: set[FoundRadio] = set()

    async def outdated(self) -> str:
        """Return when the plan is out of date, with the reason."""
        while True:
            await asyncio.sleep(self._period)
            with contextlib.suppress(OSError, ValueError):  # the system does not say now: it may the next time
                why = self.compare(await asyncio.to_thread(self._look))
                if why:
                    return why

    def compare(self, there: Interfaces) -> str | None:
        """What makes the plan out of date, in words.

        A listener on a known address comes up by itself, and lives through the address's and the interface's absence.
        Not so an address that was not known. Multicast lives through an address that goes and comes back (4 s without,
        linked again 4 s later), but not through an interface that does: to the kernel it is another one.
        """
        return next(filter(None, (self._judge(radio, there) for radio in self._radios)), None)

    def _judge(self, radio: FoundRadio, there: Interfaces) -> str | None:
        interface = radio.radio.interface
        if interface is not None and interface not in there:
            self._gone.add(radio)
            return None
        if radio.fixed and radio.address:
            wanted = radio.address.ip
            here = any(address.ip == wanted for addresses in there.values() for address in addresses)
            late = radio in self._gone or not radio.present
            return f"{radio.name} has come" if here and late and self._scouts else None
        addresses = [str(address.ip) for address in there.get(radio.name, ())]
        if not addresses or not self._matters(addresses):
            return None
        if radio.address is None:
            return f"{radio.name} has come, with {addresses[0]}"
        if str(radio.address.ip) not in addresses:
            return f"{radio.name} has now {addresses[0]}"
        return f"{radio.name} has come back" if radio in self._gone and self._scouts else None

    def _matters(self, addresses: list[str]) -> bool:
        """In the cloud a host calls from whatever address its modem was given; only a rendezvous is called at one."""
        listens = PROFILES[self._plan.profile].listens or self._plan.host.neighbours is not None
        return listens or any(is_rendezvous(self._plan, address) for address in addresses)


@contextlib.asynccontextmanager
async def watch_radios(session: zenoh.Session, plan: RouterPlan) -> AsyncIterator[object]:
    """A part of the router; there is nothing to watch where the fleet file names no radio."""
    yield RadioWatch(plan) if plan.radios else None
