"""A member's computer between two hosts is taken over: it may drop what it carries, and can forge none of it."""

from __future__ import annotations

import asyncio
import contextlib
import sys
import time
from collections.abc import AsyncIterator, Callable
from functools import partial
from pathlib import Path
from typing import TypeVar

import msgspec
import pytest
import zenoh

import zmav
from mesh.lab.lab import Lab
from tests.mesh.lab.rogue import FALSE_ALT
from tests.mesh.proofs import rigs
from zmav import wire
from zmav.errors import TimedOut
from zmav.wire import VehicleState

pytestmark = pytest.mark.root

T = TypeVar("T", bound=msgspec.Struct)
ROGUE = Path(__file__).with_name("rogue.py")
TREE = ROGUE.parents[3]


@contextlib.asynccontextmanager
async def taken_over(lab: Lab, *arguments: str) -> AsyncIterator[Path]:
    """quad1's own programs are gone, and the rogue routes in their place; what it says is in the file."""
    await lab.kill("quad1")
    said = lab.directory / f"rogue{len(arguments)}.txt"
    file = str(lab.directory / "fleet.toml")
    with said.open("w") as out:
        process = lab.spawn(
            "quad1",
            sys.executable,
            str(ROGUE),
            file,
            "quad1",
            "quad2",
            *arguments,
            stdout=out,
            stderr=out,
            env={"PYTHONPATH": str(TREE)},
        )
    try:
        while "routing" not in said.read_text():
            assert process.poll() is None, said.read_text()
            await asyncio.sleep(0.05)
        yield said
    finally:
        process.kill()
        await asyncio.to_thread(process.wait)


async def test_a_relay_that_was_taken_over(able: None, tmp_path: Path) -> None:
    async with Lab(rigs.chain(2, credentials=True), tmp_path / "lab") as lab:
        await lab.ready()
        async with rigs.station(lab) as z:
            await rigs.all_heard(z, lab)
            assert z.member is not None
            quad, counts = z.vehicle("quad2"), z.member.counts
            async with taken_over(lab) as said:
                await is_heard_again(quad)
                heard = z.subscribe("quad2/state", reads(VehicleState))
                event = z.subscribe("quad2/event", reads(wire.Event))
                async with heard as states, event as events:
                    await its_orders_are_done_and_no_others(quad, said)
                    assert counts["answer name"]
                    seen = 0
                    async for state in states:
                        assert state.position is None or state.position.alt_amsl != FALSE_ALT
                        seen += 1
                        if seen >= 20 and heard.bad >= 20:
                            break
                    async for told in events:
                        assert told.text != "forged"
                        if event.bad:
                            break
            async with taken_over(lab, "drop"):
                await is_heard_again(quad)
                quad.give_up = 3.0
                mode = quad.state.mode
                with pytest.raises(TimedOut, match="not believed"):
                    await quad.set_mode("STABILIZE")
                assert quad.state.mode == mode


async def is_heard_again(quad: zmav.Vehicle) -> None:
    """Through the relay that was just started: by what the vehicle says from now on."""
    begun = time.time()
    await quad.wait_until(lambda state: state.connected and state.t > begun, rigs.PATIENCE)


def shows(mode: str, state: VehicleState) -> bool:
    return state.mode == mode


def reads(kind: type[T]) -> Callable[[zenoh.Sample], T]:
    return lambda sample: wire.decode(sample.payload.to_bytes(), kind, "what was said")


async def its_orders_are_done_and_no_others(quad: zmav.Vehicle, said: Path) -> None:
    """Each order through the rogue is the vehicle's own to answer; sent once more by the rogue it changes nothing."""
    for count, mode in enumerate(("LOITER", "STABILIZE", "LOITER", "STABILIZE"), 1):
        await quad.set_mode(mode)
        assert (await quad.wait_until(partial(shows, mode), rigs.PATIENCE)).mode == mode
        while len(repeated := [line for line in said.read_text().splitlines() if line.startswith("[")]) < count:
            await asyncio.sleep(0.05)
        assert f'"mode":"{mode}"' in repeated[-1] or '\\"mode\\":' in repeated[-1]  # it learns what came of the orders
        assert (await quad.wait_until(lambda state: (quad.age or 0.0) < 0.5, rigs.PATIENCE)).mode == mode
