"""Orders that come together."""

from __future__ import annotations

import asyncio

import pytest

import zmav
from agents.navigator.agent import Fly, Navigator
from tests.conftest import Net
from tests.waiting import until
from zmav import keys, wire
from zmav.errors import Refused


async def test_of_two_orders_that_wait_for_the_vehicle_one_is_flown(net: Net) -> None:
    session, endpoint = net.router()
    async with zmav.open(connect=[endpoint]) as z:
        navigator = Navigator(z, "quad1")
        orders = [asyncio.create_task(navigator.on_fly(Fly(), None, None)) for _ in range(2)]
        state = wire.VehicleState(t=0.0, fleet="demo", name="quad1", instance="a", armed=True, local=(0.0, 0.0, -5.0))

        def said() -> bool:
            session.put(keys.STATE.key("demo", "quad1"), wire.encode(state))
            return any(order.done() for order in orders)

        await until(said, "both are flown")
        (refused,) = [order for order in orders if order.done()]
        with pytest.raises(Refused, match="already"):
            refused.result()
        await navigator.end_flight()
        await asyncio.gather(*orders, return_exceptions=True)
