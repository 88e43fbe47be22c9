"""A vehicle tells what its key space is, as programs read it."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from zmav import keys, schemas, wire
from zmav.errors import BadInput

if TYPE_CHECKING:
    from tests.services.conftest import StartBench


async def test_a_vehicle_tells_what_it_speaks(bench: StartBench) -> None:
    ground = (await bench()).ground
    for name, expected in (("asyncapi", schemas.asyncapi()), ("Setpoint", schemas.payload_schema("Setpoint"))):
        (reply,) = await ground.ask(keys.SCHEMA.key("demo", "quad1", schema=name))
        assert reply.ok is not None
        assert json.loads(reply.ok.payload.to_bytes()) == expected
    (reply,) = await ground.ask(keys.SCHEMA.key("demo", "quad1", schema="Nothing"))
    assert reply.err is not None
    assert isinstance(wire.error_from(reply.err.payload.to_bytes()), BadInput)
