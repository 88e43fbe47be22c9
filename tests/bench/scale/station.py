"""The ground of a study: a client that reads what a ground station reads, and says how long it took.

Its process is driven as :mod:`tests.bench.scale.node` is.
"""

from __future__ import annotations

import asyncio
import json
import random
import statistics
import sys
import time
from typing import Any

import zmav
from tests.bench.scale.footprint import STREAMED
from tests.bench.scale.group import GROUP, GroupMember, GroupStates
from tests.bench.scale.node import count_tokens, usage
from zmav import keys, wire
from zmav.errors import BadInput, ZmavError

TRIES = 3
PINGS = 20
RAW = "v0"
"""the vehicle whose raw telemetry is read"""


class Station:
    """An open client and its counters."""

    def __init__(self, z: zmav.Client, fleet: str, vehicles: int) -> None:
        self._z, self._fleet, self._vehicles = z, fleet, vehicles
        self._states = self._raw = self._bytes = self._groups = 0
        self._members: dict[str, GroupMember] = {}
        self._wants: list[Any] = []

    async def watch(self) -> None:
        """Count states as they are taken (the client itself decodes them too), and one vehicle's frames."""

        def state(sample: Any) -> None:
            self._states += 1
            self._bytes += len(sample.payload.to_bytes())

        def raw(sample: Any) -> None:
            self._raw += 1

        session = self._z.session
        session.declare_subscriber(keys.STATE.key(self._fleet, "*"), state)
        session.declare_subscriber(keys.RX.key(self._fleet, RAW, sys="*", comp="*", msg="*"), raw)

    async def watch_groups(self) -> None:
        """Count what the gateways say instead."""

        def heard(sample: Any) -> None:
            self._groups += 1
            self._bytes += len(sample.payload.to_bytes())
            try:
                states = wire.decode(sample.payload.to_bytes(), GroupStates, "a group's states")
            except BadInput:
                return
            self._members.update({each.name: each for each in states.vehicles})

        def raw(sample: Any) -> None:
            self._raw += 1

        session = self._z.session
        session.declare_subscriber(GROUP.key(self._fleet, group="*"), heard)
        session.declare_subscriber(keys.RX.key(self._fleet, RAW, sys="*", comp="*", msg="*"), raw)
        for msg, (hz, _) in STREAMED.items():  # a gateway lets out what a token asks for
            want = keys.WANT.key(self._fleet, RAW, msg=msg, hz=f"{hz:g}", instance="station")
            self._wants.append(session.liveliness().declare_token(want))

    async def do(self, verb: str) -> dict[str, Any]:
        if verb == "known":
            heard = self._members or {v.name for v in self._z.fleet() if v.age is not None}
            return {"known": len(heard), **usage()}
        if verb == "ask":
            return await self._ask()
        if verb == "tokens":
            return await asyncio.to_thread(self._history)
        if verb == "ping":
            return await self._ping()
        return {
            **usage(),
            "states": self._states,
            "raw": self._raw,
            "bytes": self._bytes,
            "groups": self._groups,
            "t": time.monotonic(),
        }

    async def _ask(self) -> dict[str, Any]:
        start = time.perf_counter()
        answers = await self._z.ask(keys.STATE.key(self._fleet, "*"), timeout=20.0)
        return {"seconds": time.perf_counter() - start, "answers": len(answers)}

    def _history(self) -> dict[str, Any]:
        """One that comes back empty was lost on the way (seen once on a busy machine): asked again, and timed again."""
        for _ in range(TRIES):
            start = time.perf_counter()
            found = count_tokens(self._z.session, self._fleet)
            seconds = time.perf_counter() - start
            if found:
                break
        return {"seconds": seconds, "answers": found}

    async def _ping(self) -> dict[str, Any]:
        took, lost = [], 0
        for number in random.Random(1).choices(range(self._vehicles), k=PINGS):
            try:
                took.append(await self._z.vehicle(f"v{number}").ping())
            except ZmavError:
                lost += 1
        return {"median": statistics.median(took) if took else None, "worst": max(took, default=None), "lost": lost}


async def main() -> None:
    how = json.loads(sys.argv[1])
    loop = asyncio.get_running_loop()
    async with zmav.open(fleet=how["fleet"], connect=how["connect"]) as z:
        station = Station(z, how["fleet"], how["vehicles"])
        await (station.watch_groups() if how["groups"] else station.watch())
        print(json.dumps({"ready": str(z.session.info.zid())}), flush=True)
        while line := await loop.run_in_executor(None, sys.stdin.readline):
            print(json.dumps(await station.do(json.loads(line)["do"])), flush=True)


if __name__ == "__main__":
    asyncio.run(main())
