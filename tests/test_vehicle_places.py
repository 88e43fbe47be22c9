"""Where a vehicle is, as often as it says so, on a link on which others speak, too."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import pytest
import zenoh

import zmav
from zmav import keys, wire
from zmav.mavlink import encode, load_dialect
from zmav.waiting import within

if TYPE_CHECKING:
    from tests.conftest import Net

PATIENCE_S = 30.0
OWN, OTHER = (7, 1), (42, 1)
CAMERA = (7, 100)
"""of the same system, but not its autopilot"""


def say_state(session: zenoh.Session) -> None:
    state = wire.VehicleState(
        t=time.time(),
        fleet="demo",
        name="quad1",
        instance="ghost",
        sysid=OWN[0],
        compid=OWN[1],
        position=wire.GlobalPosition(lat_deg=-35.0, lon_deg=149.0, alt_amsl=584.0, alt_rel=5.0),
        local=(0.0, 0.0, -5.0),
        velocity=(0.0, 0.0, 0.0),
    )
    session.put(keys.STATE.key("demo", "quad1"), wire.encode(state))


def say_place(session: zenoh.Session, sender: tuple[int, int], vx_cm: int) -> None:
    fields = dict.fromkeys(("time_boot_ms", "relative_alt", "vy", "vz", "hdg"), 0)
    fields |= {"lat": -350000000, "lon": 1490000000, "alt": 584000, "vx": vx_cm}
    sysid, compid = sender
    frame = encode(load_dialect(), "GLOBAL_POSITION_INT", fields, sysid=sysid, compid=compid)
    session.put(keys.RX.key("demo", "quad1", sys=sysid, comp=compid, msg="GLOBAL_POSITION_INT"), frame)


async def test_where_others_on_its_link_are_is_not_where_it_is(net: Net) -> None:
    session, endpoint = net.router()
    async with zmav.open(connect=[endpoint]) as z:
        await net.linked(session, keys.STATE.key("demo", "quad1"))
        say_state(session)
        (quad,) = await z.wait_for("quad1", timeout=PATIENCE_S)
        async with quad.places(10.0) as places:
            await net.linked(session, keys.RX.key("demo", "quad1", sys=1, comp=1, msg="GLOBAL_POSITION_INT"))
            for sender, vx_cm in ((OTHER, 900), (CAMERA, 800), (OWN, 100)):
                say_place(session, sender, vx_cm)
            place = await within(PATIENCE_S, places.get())
            assert place.vel == (1.0, 0.0, 0.0)
            assert place.pos == pytest.approx((0.0, 0.0, -5.0), abs=0.02)
            assert places.bad == 2
