"""A gateway's host in a study: the trunk's router in this process, and a client of its group's router."""

from __future__ import annotations

import asyncio
import json
import sys

from tests.bench.scale.gateway import Gateway
from tests.bench.scale.node import usage
from zmav.session import SessionSettings, open_session


async def main() -> None:
    how = json.loads(sys.argv[1])
    loop = asyncio.get_running_loop()
    trunk = SessionSettings(mode="router", listen=how["listen"], connect=how["connect"], cfg=("scouting/delay:0",))
    with open_session(SessionSettings(connect=how["inside"])) as inside, open_session(trunk) as outside:
        async with Gateway(inside, outside, how["fleet"], how["group"]) as gateway:
            print(json.dumps({"ready": str(outside.info.zid())}), flush=True)
            while await loop.run_in_executor(None, sys.stdin.readline):
                said = {**usage(), "doors": gateway.doors, "routers": len(outside.info.routers_zid())}
                print(json.dumps(said), flush=True)


if __name__ == "__main__":
    asyncio.run(main())
