"""Parameters over a bad link, and out of a recording: the whole chain from frames to the table."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from tests.services.params.param_peer import many, scenes
from zmav import wire

if TYPE_CHECKING:
    from tests.conftest import Net, StartOnboard
    from tests.services.conftest import StartBench
    from tests.services.params.param_peer import StartScene


@pytest.fixture
async def scene(bench: StartBench) -> AsyncIterator[StartScene]:
    async with scenes(bench) as start:
        yield start


async def test_a_thousand_parameters_at_20_percent_loss_and_200_ms_delay(scene: StartScene) -> None:
    """Acceptance: read to the last one, then set and read back, without an error."""
    params = many(1000)
    s = await (await scene(params, link="lossy:{}?loss=0.2&delay=0.2")).read()
    assert await s.values() == {name: value for name, (value, _) in params.items()}
    outcome = await s.b.ground.do("param_set", name="P_0500", value=-1)
    assert outcome.result["value"] == -1.0
    result = (await s.b.ground.do("param_load", values={f"P_{i:04d}": i + 0.5 for i in range(8)})).result
    assert (len(result["set"]), result["failed"]) == (8, {})
    assert s.peer.params["P_0007"][0] == 7.5


async def test_a_recorded_download_is_what_pymavlink_makes_of_it(
    net: Net, onboard: StartOnboard, shared_data: Path
) -> None:
    """A real ArduPilot's answers, heard without having asked: the same names and values."""
    expected = _by_pymavlink(shared_data / "copter_params.tlog")
    session, endpoint = net.router()
    ground = net.ground(endpoint)
    states = ground.samples("zmav/demo-replay/quad1/state")
    vehicle = await onboard(session, f"replay:{shared_data / 'copter_params.tlog'}", fleet="demo-replay")
    await states.until(lambda: vehicle.params.known.complete, "complete set")
    (reply,) = await ground.ask("zmav/demo-replay/quad1/param")
    assert reply.ok is not None
    table = wire.decode(reply.ok.payload.to_bytes(), wire.ParamTable, "param")
    found = {p.name: (_float(p.value), wire.PARAM_TYPES.index(p.type) + 1) for p in table.params}
    assert table.count == len(found) == 1354
    assert found == expected


def _by_pymavlink(path: Path) -> dict[str, tuple[float, int]]:
    from pymavlink import mavutil

    log = mavutil.mavlink_connection(str(path), dialect="ardupilotmega")
    found: dict[str, tuple[float, int]] = {}
    while (message := log.recv_match(type="PARAM_VALUE")) is not None:
        found[message.param_id] = (message.param_value, message.param_type)
    return found


def _float(value: Any) -> float:
    from zmav.mavlink.paramvalue import float32

    return float32(value)
