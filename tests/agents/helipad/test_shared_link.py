"""On a link on which others speak, a picture is taken to be from where the vehicle itself is, turned as it is."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING

import pytest

import zmav
from agents.helipad.agent import Helipad
from tests.test_vehicle_places import OTHER, OWN, PATIENCE_S, say_place, say_state
from tests.waiting import until
from zmav import keys
from zmav.mavlink import encode, load_dialect

if TYPE_CHECKING:
    import zenoh

    from tests.conftest import Net


def say_attitude(session: zenoh.Session, sender: tuple[int, int], roll: float) -> None:
    fields = dict.fromkeys(("pitch", "yaw", "rollspeed", "pitchspeed", "yawspeed"), 0.0)
    sysid, compid = sender
    what = {"time_boot_ms": 0, "roll": roll, **fields}
    frame = encode(load_dialect(), "ATTITUDE", what, sysid=sysid, compid=compid)
    session.put(keys.RX.key("demo", "quad1", sys=sysid, comp=compid, msg="ATTITUDE"), frame)


async def test_anothers_attitude_is_not_its_own(net: Net) -> None:
    session, endpoint = net.router()
    async with zmav.open(connect=[endpoint]) as z:
        await net.linked(session, keys.STATE.key("demo", "quad1"))
        say_state(session)
        await z.wait_for("quad1", timeout=PATIENCE_S)
        helipad = Helipad(z, "quad1")
        running = asyncio.create_task(helipad.run())
        rolls: list[float] = []

        def known() -> bool:
            say_place(session, OWN, 0)
            for sender, roll in ((OWN, 0.1), (OTHER, 0.9)):
                say_attitude(session, sender, roll)
            pose = helipad.poses.at(time.time() - 0.02)
            if pose is not None:
                rolls.append(pose.roll)
            return len(rolls) >= 10

        try:
            await until(known, "it does not know where it is", PATIENCE_S)
        finally:
            running.cancel()
            await asyncio.gather(running, return_exceptions=True)
        assert rolls == pytest.approx([0.1] * len(rolls), abs=1e-6)
