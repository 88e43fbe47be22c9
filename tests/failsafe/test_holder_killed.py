"""The program that holds the lease is killed (-9) in the middle of its stream."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.failsafe.conftest import PATIENT, agent, held, moves, stops
from tests.services.conftest import StartBench

PROGRAM = """
import asyncio, sys, zmav

async def main():
    async with zmav.open(connect=[sys.argv[1]]) as z:
        (vehicle,) = await z.wait_for("quad1", timeout=30)
        async with vehicle.lease("victim", ttl=60) as lease:
            print("flying", flush=True)
            while True:
                lease.setpoint(vel=(1.5, -0.5, 0.25))
                await asyncio.sleep(0.05)

asyncio.run(main())
"""


@pytest.fixture
def program(tmp_path: Path) -> Iterator[Path]:
    path = tmp_path / "victim.py"
    path.write_text(PROGRAM)
    yield path


async def test_it_holds_when_the_process_is_gone(bench: StartBench, program: Path) -> None:
    """... by the loss of its liveliness: the stream may be silent for a minute here, and the lease lasts as long."""
    b = await bench(settings={"failsafe": PATIENT})
    alice = await agent(b, "alice")
    await b.ground.do("release", lease=alice.token)
    victim = subprocess.Popen([sys.executable, str(program), b.endpoint], stdout=subprocess.PIPE)
    try:
        await b.peer.until(lambda: len(moves(b)) > 5, "its stream")
        assert stops(b) == []
        victim.kill()
        killed = asyncio.get_running_loop().time()
        await held(b)
    finally:
        victim.kill()
        victim.wait()
        assert victim.stdout is not None
        victim.stdout.close()
    await b.event("victim, who held the lease, is gone", kind="lease")
    assert stops(b)[0].at - killed < 5.0
    assert (await b.state(lambda s: s["lease"] is None, "no lease"))["lease_end"]["reason"] == "gone"
