"""Both older faces with an autopilot behind them: what a script sends is flown, what it asks for flows."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import pytest

from zmav import wire
from zmav.onboard import Onboard, OnboardSettings
from zmav.sim import World

if TYPE_CHECKING:
    from tests.ground.http.conftest import Reply, Serve, Served

HOME = wire.Origin(lat_deg=-35.363261, lon_deg=149.165230, alt_amsl=584.09)
PATIENCE_S = 60.0


@pytest.fixture(scope="module")
def flown(serve: Serve) -> Iterator[Served]:
    """quad1 on the ground and ready, simulated eight times as fast as life."""
    served = serve()
    running, stop = threading.Event(), threading.Event()

    async def fly(link: str) -> None:
        async with Onboard(served.session, OnboardSettings(link=link, name="quad1", origin=HOME)):
            running.set()
            await asyncio.to_thread(stop.wait)

    with World(copters=1, endpoint="tcp:127.0.0.1:0", speed=8.0, ready_s=0.5) as world:
        thread = threading.Thread(target=lambda: asyncio.run(fly(world.urls[0])))
        thread.start()
        assert running.wait(PATIENCE_S)
        ready = lambda: (s := served.gateway.client.vehicle("quad1").last_state) is not None and bool(s.ready)  # noqa: E731
        served.until(ready, "vehicle that is ready")
        yield served
        stop.set()
        thread.join(PATIENCE_S)


def command(name: str, **params: float) -> dict[str, Any]:
    """A COMMAND_LONG as mavlink2rest's documentation has it."""
    zeros = {f"param{n}": 0.0 for n in range(1, 8)}
    return {
        "header": {"system_id": 255, "component_id": 240, "sequence": 0},
        "message": {
            "type": "COMMAND_LONG",
            **zeros,
            **params,
            "command": {"type": name},
            "target_system": 1,
            "target_component": 1,
            "confirmation": 0,
        },
    }


def until(ask: Callable[[], Reply], true: Callable[[Any], bool]) -> Any:
    """Ask again until the answer is as wanted."""
    for _ in range(3000):
        reply = ask()
        if reply.status == 200 and true(reply):
            return reply
    raise AssertionError(reply)


def test_a_script_of_mavlink2rest_s_arms_and_disarms(flown: Served) -> None:
    mode = "/v1/mavlink/vehicles/1/components/1/messages/HEARTBEAT/message/base_mode"
    assert flown.post("/v1/mavlink", command("MAV_CMD_COMPONENT_ARM_DISARM", param1=1.0)).status == 200
    until(lambda: flown.get(mode), lambda reply: "MAV_MODE_FLAG_SAFETY_ARMED" in reply.json)
    assert flown.post("/v1/mavlink", command("MAV_CMD_COMPONENT_ARM_DISARM", param1=0.0)).status == 200
    until(lambda: flown.get(mode), lambda reply: "MAV_MODE_FLAG_SAFETY_ARMED" not in reply.json)


def test_a_script_of_mavlink2rest_s_sets_a_message_s_interval(flown: Served) -> None:
    interval = command("MAV_CMD_SET_MESSAGE_INTERVAL", param1=116.0, param2=50_000.0)  # SCALED_IMU2
    assert flown.post("/v1/mavlink", interval).status == 200
    path = "/v1/mavlink/vehicles/1/components/1/messages"
    until(lambda: flown.get(path), lambda reply: "SCALED_IMU2" in reply.json)


def test_what_is_asked_for_by_name_flows(flown: Served) -> None:
    text = until(lambda: flown.get("/last/1/1/VIBRATION"), lambda reply: True).text
    assert text.splitlines()[0].startswith("age ")
    assert [line.split()[0] for line in text.splitlines()[2:5]] == [f"vibration_{axis}" for axis in "xyz"]


def test_a_mode_set_by_urlread_is_entered(flown: Served) -> None:
    assert flown.get("/send/1/1/SET_MODE", base_mode=1, custom_mode=5).status == 200
    until(
        lambda: flown.get("/vehicles"),
        lambda reply: reply.text.split() == ["quad1", "1", "1", "ardupilot", "copter", "LOITER", "0"],
    )
    refused = flown.get("/send/1/1/SETUP_SIGNING", secret_key=",".join(["0"] * 32), initial_timestamp=0)
    assert refused.status == 409
    assert "holds a key, which does not travel" in refused.text
