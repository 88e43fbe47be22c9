"""Calling for neighbours by multicast oftener than Zenoh does: when a router has started, and when it lost one.

Zenoh 1.10 calls when it starts, 1, 3 and 7 s later and then every 8 s, and has no setting for it. So a neighbour that
is heard again is linked up to 8 s later, and where many datagrams are lost a mesh may take minutes to form. We send the
same call from the same sockets: the answers come to Zenoh, which links as ever.
"""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import os
import random
import socket
import time
from collections.abc import AsyncIterator, Collection, Iterator
from pathlib import Path

import zenoh

from mesh.plan import RouterPlan
from mesh.radios import FoundRadio
from zmav.waiting import alongside

CALL = bytes((0x01, 0x09, 0x01))
"""as it travels: a Scout, of Zenoh's protocol 9, for routers"""
GROUP = ("224.0.0.224", 7446)
"""Zenoh's own, which no profile changes"""
PERIOD_S = 1.0
FOR_S = 120.0
"""after the start and after each loss; then Zenoh's own calls are enough. A call that is lost half-way has the other
side's listener take no other for 30 s (docs/mesh.md, Limits of Zenoh), and such times can follow on each other. One
link at 30 % loss, called again 1 s after a call that failed: 2.6 s in the median, p90 13 s; after 8 s: 1.8 s and 33 s
"""


class Calls:
    """The sockets that Zenoh calls from, of a router that has just been opened. ``close`` it."""

    def __init__(self, radios: Collection[FoundRadio], now: float, group: tuple[str, int] = GROUP) -> None:
        self._group = group
        self._sockets = list(_callers({str(each.address.ip) for each in radios if each.address}))
        self._until = now + FOR_S

    def lost(self, now: float) -> None:
        """A neighbour is gone. From any thread."""
        self._until = now + FOR_S

    def call(self, now: float) -> int:
        """Call, where it is worth it; on how many radios."""
        sent = 0
        for each in self._sockets if now < self._until else ():
            with contextlib.suppress(OSError):  # the radio is not there just now
                each.sendto(CALL, self._group)
                sent += 1
        return sent

    def close(self) -> None:
        for each in self._sockets:
            each.close()


def _callers(addresses: Collection[str]) -> Iterator[socket.socket]:
    """Doubles of this process's UDP sockets that send multicast out of one of these addresses, and take any answer."""
    with contextlib.suppress(FileNotFoundError):  # no Linux: Zenoh calls alone
        for path in Path("/proc/self/fd").iterdir():
            try:
                double = os.dup(int(path.name))
            except OSError:  # closed meanwhile
                continue
            try:
                found = socket.socket(fileno=double)
            except OSError:  # no socket
                os.close(double)
                continue
            if _calls(found, addresses):
                yield found
            else:
                found.close()


def _calls(found: socket.socket, addresses: Collection[str]) -> bool:
    if (found.family, found.type) != (socket.AF_INET, socket.SOCK_DGRAM):
        return False
    interface = found.getsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, 4)
    return found.getsockname()[0] == "0.0.0.0" and str(ipaddress.IPv4Address(interface)) in addresses


@contextlib.asynccontextmanager
async def call_oftener(session: zenoh.Session, plan: RouterPlan) -> AsyncIterator[Calls | None]:
    """A part of the router, where neighbours are looked for by multicast."""
    if not plan.scouts_on:
        yield None
        return
    calls = Calls([each for each in plan.radios if each.radio.interface in plan.scouts_on], time.monotonic())

    def on_transport(event: zenoh.TransportEvent) -> None:
        if event.kind == zenoh.SampleKind.DELETE and event.transport.whatami == zenoh.WhatAmI.ROUTER:
            calls.lost(time.monotonic())

    listener = session.info.declare_transport_events_listener(on_transport)
    try:
        async with alongside(_run(calls)):
            yield calls
    finally:
        with contextlib.suppress(zenoh.ZError):  # the session may be closed
            listener.undeclare()
        calls.close()


async def _run(calls: Calls) -> None:
    while True:
        calls.call(time.monotonic())
        await asyncio.sleep(PERIOD_S * random.uniform(0.8, 1.2))  # in step with nobody
