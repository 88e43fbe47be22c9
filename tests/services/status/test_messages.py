"""``msg/{MSG}``: the last message of a name, decoded when somebody asks."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

from zmav import wire
from zmav.errors import BadInput
from zmav.mavlink import Packer

if TYPE_CHECKING:
    from tests.services.conftest import Bench, StartBench


async def last(b: Bench, name: str) -> wire.LastMessage:
    (reply,) = await b.ground.ask(f"zmav/demo/quad1/msg/{name}")
    if reply.ok is None:
        assert reply.err is not None
        raise wire.error_from(reply.err.payload.to_bytes())
    return wire.decode(reply.ok.payload.to_bytes(), wire.LastMessage, name)


def unknown(sysid: int, payload: bytes = b"\x01\x02\xff", msgid: int = 44010) -> bytes:
    """A frame of a message that the dialect lacks; its checksum nobody can check."""
    return bytes((0xFD, len(payload), 0, 0, 7, sysid, 1)) + msgid.to_bytes(3, "little") + payload + b"\x12\x34"


async def test_the_last_one_with_names_units_age_and_count(bench: StartBench) -> None:
    b = await (await bench(sysid=4)).connected()
    for yaw in (0.5, 1.5):
        b.peer.send("ATTITUDE", time_boot_ms=17, yaw=yaw, roll=math.nan)
    b.peer.send("SYS_STATUS", voltage_battery=12600)
    await b.state(lambda s: s["battery"], "both")
    found = await last(b, "ATTITUDE")
    assert (found.name, found.id, found.sysid, found.compid, found.count) == ("ATTITUDE", 30, 4, 1, 2)
    assert (found.verified, found.signed) == (True, False)
    assert found.age >= 0.0
    assert (found.fields["yaw"], found.fields["roll"], found.fields["time_boot_ms"]) == (1.5, None, 17)
    assert (found.units["yaw"], found.units["rollspeed"], found.units["time_boot_ms"]) == ("rad", "rad/s", "ms")
    assert (await last(b, "HEARTBEAT")).fields["type"] == "MAV_TYPE_QUADROTOR"
    younger = (await last(b, "ATTITUDE")).age
    assert younger > found.age


async def test_messages_the_dialect_lacks(bench: StartBench) -> None:
    b = await (await bench()).connected()
    b.peer.raw(unknown(1))
    b.peer.send("SYS_STATUS")
    await b.state(lambda s: s["battery"], "what came after it")
    found = await last(b, "UNKNOWN_44010")
    assert (found.name, found.id, found.sysid, found.seq, found.verified) == ("UNKNOWN_44010", 44010, 1, 7, False)
    assert found.fields == {"payload": "0102ff"}


UNHEARD = [
    ("NONSENSE", "NONSENSE"),
    ("attitude", "ATTITUDE"),
    ("ATTITUDE", "no ATTITUDE has come from quad1; heard so far: AUTOPILOT_VERSION, COMMAND_ACK, HEARTBEAT"),
    ("UNKNOWN_44011", "no UNKNOWN_44011 has come"),
    ("UNKNOWN_²", "UNKNOWN_²"),
    ("UNKNOWN_", "UNKNOWN_"),
    ("UNKNOWN_99999999999999999999999", "no UNKNOWN_9999"),
]


async def test_what_was_not_heard(bench: StartBench, subtests: pytest.Subtests) -> None:
    b = await (await bench()).connected()
    await b.state(lambda s: True, "the acknowledgements of what it was asked")
    for name, words in UNHEARD:
        with subtests.test(name):
            with pytest.raises(BadInput) as e:
                await last(b, name)
            assert words in e.value.message


async def test_all_of_them_and_some(bench: StartBench) -> None:
    b = await (await bench()).connected()
    b.peer.raw(unknown(1))
    b.peer.send("SYS_STATUS")
    await b.state(lambda s: s["battery"], "the last one")
    for asked, wanted in (
        ("*", {"AUTOPILOT_VERSION", "COMMAND_ACK", "HEARTBEAT", "SYS_STATUS", "UNKNOWN_44010"}),
        ("S$*", {"SYS_STATUS"}),
        ("UNKNOWN_$*", {"UNKNOWN_44010"}),
        ("X$*", set()),
    ):
        replies = await b.ground.ask(f"zmav/demo/quad1/msg/{asked}")
        keys = [str(r.ok.key_expr) for r in replies if r.ok is not None]
        assert len(keys) == len(replies)
        assert sorted(keys) == sorted(f"zmav/demo/quad1/msg/{name}" for name in wanted)


async def test_the_autopilot_s_own_goes_before_another_component_s(bench: StartBench) -> None:
    b = await (await bench()).connected()
    camera = Packer(b.peer.dialect, 1, 100)
    b.peer.beating = False
    b.peer.raw(camera.pack("HEARTBEAT", type=30, autopilot=8))
    b.peer.raw(camera.pack("CAMERA_INFORMATION", resolution_h=640))
    b.peer.send("SYS_STATUS")
    await b.state(lambda s: s["battery"], "the last one")
    assert (await last(b, "HEARTBEAT")).compid == 1
    seen = await last(b, "CAMERA_INFORMATION")
    assert (seen.compid, seen.fields["resolution_h"]) == (100, 640)
