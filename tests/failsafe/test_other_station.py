"""Another station on ``mav/tx``: its change of mode takes the vehicle before any HEARTBEAT shows it, and its setpoints
wait for the agent that commands.
"""

from __future__ import annotations

from typing import Any

import pytest

from tests.failsafe.conftest import PATIENT, agent, moves, nothing_more
from tests.services.conftest import LOITER, SET_MODE, Bench, StartBench
from zmav import keys
from zmav.mavlink import Packer, load_dialect
from zmav.mavlink.ftp import Op, Packet, pack, unpack

LOCAL, FTP = "SET_POSITION_TARGET_LOCAL_NED", "FILE_TRANSFER_PROTOCOL"


def put(b: Bench, name: str, **fields: Any) -> None:
    """What a ground station with system id 255 sends to the autopilot."""
    frame = Packer(load_dialect(), 255, 190).pack(name, target_system=1, target_component=1, **fields)
    b.ground.put(keys.TX, frame, sys=1, comp=1, msg=name)


@pytest.mark.parametrize(
    "command", [SET_MODE, 262, 20, 21, 300], ids=["mode", "standard mode", "RTL", "land", "mission"]
)
async def test_its_mode_takes_the_vehicle_at_once(bench: StartBench, command: int) -> None:
    b = await bench(settings={"failsafe": PATIENT})
    alice = await agent(b)
    await alice.fly()
    b.peer.beating = False
    put(b, "COMMAND_LONG", command=command, param1=1.0, param2=float(LOITER))
    end = (await b.state(lambda s: s["lease"] is None, "no lease"))["lease_end"]
    assert end["reason"] == "pilot"
    assert "station 255 ordered" in end["text"]
    assert b.vehicle.identity.mode == "GUIDED", "the HEARTBEAT has not shown it yet"
    await nothing_more(b)


async def test_set_mode_the_old_way(bench: StartBench) -> None:
    b = await bench(settings={"failsafe": PATIENT})
    alice = await agent(b)
    await alice.fly()
    frame = Packer(load_dialect(), 255, 190).pack("SET_MODE", target_system=1, base_mode=1, custom_mode=LOITER)
    b.ground.put(keys.TX, frame, sys=1, comp=0, msg="SET_MODE")
    end = (await b.state(lambda s: s["lease"] is None, "no lease"))["lease_end"]
    assert "station 255 ordered SET_MODE" in end["text"]


@pytest.mark.parametrize("name", ["COMMAND_LONG", "COMMAND_INT", "SET_MODE"])
async def test_its_mode_takes_an_autopilot_whose_modes_nobody_knows(bench: StartBench, name: str) -> None:
    b = await bench(settings={"failsafe": PATIENT}, autopilot=0)
    alice = await agent(b)
    alice.put(vel=None, rc=[1500])
    await b.peer.count("RC_CHANNELS_OVERRIDE", 1)
    b.peer.beating = False
    fields = {"base_mode": 1, "custom_mode": LOITER} if name == "SET_MODE" else {"command": SET_MODE, "param1": 1.0}
    frame = Packer(load_dialect(), 255, 190).pack(name, target_system=1, **fields)
    b.ground.put(keys.TX, frame, sys=1, comp=0, msg=name)
    end = (await b.state(lambda s: s["lease"] is None, "no lease"))["lease_end"]
    assert (end["reason"], "station 255 ordered" in end["text"]) == ("pilot", True)


async def test_other_commands_take_nothing(bench: StartBench) -> None:
    b = await bench(settings={"failsafe": PATIENT})
    alice = await agent(b)
    await alice.fly()
    put(b, "COMMAND_LONG", command=178, param2=5.0)
    await b.peer.until(lambda: bool(b.peer.commands(178)), "the command")
    await alice.fly()
    state = await b.state(lambda s: True, "a state")
    assert state["lease"]["holder"] == "alice"


async def test_its_setpoints_wait_for_the_lease(bench: StartBench) -> None:
    b = await bench(settings={"failsafe": PATIENT})
    alice = await agent(b)
    put(b, LOCAL, coordinate_frame=1, type_mask=0x0DC7, vx=9.0)
    await b.event("alice commands quad1", kind="refused")
    assert moves(b) == []
    await b.ground.do("release", lease=alice.token)
    put(b, LOCAL, coordinate_frame=1, type_mask=0x0DC7, vx=9.0)
    await b.peer.until(lambda: [t.fields["vx"] for t in b.peer.heard(LOCAL)][-1:] == [9.0], "the station's setpoint")


@pytest.mark.parametrize("name", ["MISSION_ITEM", "MISSION_ITEM_INT"])
async def test_its_guided_items_are_setpoints_and_those_of_a_plan_are_not(bench: StartBench, name: str) -> None:
    """ArduPilot flies to an item whose ``current`` is 2, and changes its height by one whose is 3."""
    b = await bench(settings={"failsafe": PATIENT})
    alice = await agent(b)
    for current in (2, 3, 0):
        put(b, name, current=current, command=16, frame=3, z=30.0)
    await b.peer.until(lambda: bool(b.peer.heard(name)), "the item of a plan")
    assert [t.fields["current"] for t in b.peer.heard(name)] == [0]
    await b.event("alice commands quad1", kind="refused")
    await b.ground.do("release", lease=alice.token)
    put(b, name, current=2, command=16, frame=3, z=30.0)
    await b.peer.until(lambda: bool(b.peer.heard(name, current=2)), "the station's place")


async def test_it_writes_no_plan_and_no_parameters_as_a_file(bench: StartBench) -> None:
    """ArduPilot takes what is written to such a file for one or the other. Reading goes on, as does a session."""
    b = await (await bench()).connected()
    taken = [
        Packet(9, 0, Op.OPEN_FILE_RO, 16, data=b"@PARAM/param.pck"),
        Packet(10, 0, Op.WRITE_FILE, 4, data=b"@PAR"),
        Packet(11, 0, Op.CREATE_FILE, 10, data=b"/APM/a.lua"),
        Packet(12, 0, Op.TERMINATE_SESSION),
    ]
    for packet in (
        Packet(1, 0, Op.CREATE_FILE, 16, data=b"@PARAM/param.pck"),
        Packet(2, 0, Op.OPEN_FILE_WO, 20, data=b"@MISSION/mission.dat"),
        Packet(3, 0, Op.OPEN_FILE_WO, 0, data=b"@MISSION/mission.dat"),  # it says a size that is not its name's
        Packet(4, 0, Op.TRUNCATE_FILE, 22, data=b"//@MISSION/mission.dat"),
        Packet(5, 0, Op.RENAME, 17, data=b"/APM/a\0@SYS/a.txt"),
        *taken,
    ):
        put(b, FTP, payload=pack(packet))
    await b.peer.until(lambda: len(b.peer.heard(FTP, target_component=1)) >= len(taken), "what may pass")
    ours = [t for t in b.peer.heard(FTP) if t.source == (255, 190)]
    assert [unpack(t.fields["payload"]).seq for t in ours] == [packet.seq for packet in taken]
    await b.event("@PARAM/param.pck is no file on the autopilot's disk: mission_upload writes plans", kind="refused")
