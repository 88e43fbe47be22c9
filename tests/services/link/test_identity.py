"""Who the vehicle is: found late, lost, found again, exchanged, and not mistaken for others on its link."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from zmav.errors import BadConfig
from zmav.mavlink import Packer
from zmav.onboard import Onboard, OnboardSettings

if TYPE_CHECKING:
    from tests.conftest import Net
    from tests.services.conftest import StartBench, StartPeer

QUADROTOR, GCS, GIMBAL, ONBOARD_CONTROLLER, ROVER = 2, 6, 26, 18, 10
GENERIC, INVALID, ARDUPILOT, PX4 = 0, 8, 3, 12


async def test_an_autopilot_that_comes_late(bench: StartBench, peer: StartPeer) -> None:
    one = await peer(sysid=7, uid=0x2A)
    one.beating = False
    b = await bench(one)
    early = await b.state(lambda s: s["link"] == "up", "link")
    assert (early["connected"], early["sysid"], early["mode"]) == (False, None, None)
    one.beating = True
    state = await b.state(lambda s: s["uid"], "autopilot with its uid")
    assert (state["connected"], state["sysid"], state["compid"]) == (True, 7, 1)
    assert (state["autopilot"], state["kind"], state["uid"], state["firmware"]) == (
        "ardupilot",
        "copter",
        f"{0x2A:016x}",
        "4.7.0",
    )
    said = await b.event("ardupilot copter with system id 7", kind="autopilot")
    assert said["severity"] == "notice"


async def test_silence_is_said_and_so_is_its_end(bench: StartBench) -> None:
    b = await (await bench()).connected()
    b.peer.beating = False
    state = await b.state(lambda s: not s["connected"], "disconnection")
    assert (state["sysid"], state["mode"], state["link"]) == (1, "STABILIZE", "up")
    said = await b.event("autopilot silent", kind="autopilot")
    assert said["severity"] == "critical"
    b.peer.beating = True
    await b.connected()
    await b.event("autopilot 1 is heard again", kind="autopilot")


async def test_exchanged_for_one_with_another_system_id_and_uid(bench: StartBench) -> None:
    b = await (await bench(sysid=1, uid=11)).connected()
    b.peer.beating = False
    await b.state(lambda s: not s["connected"], "disconnection")
    b.peer.packer, b.peer.uid, b.peer.beating = Packer(b.peer.dialect, 9, 1), 99, True
    state = await b.state(lambda s: s["connected"] and s["uid"], "the new autopilot")
    assert (state["sysid"], state["uid"]) == (9, f"{99:016x}")
    await b.event("ardupilot copter with system id 9")
    await b.peer.until(lambda: any(t.source == (9, 191) for t in b.peer.heard("HEARTBEAT")), "heartbeat as system 9")


async def test_exchanged_for_one_with_the_same_system_id(bench: StartBench) -> None:
    b = await (await bench(uid=11)).connected()
    b.peer.beating = False
    await b.state(lambda s: not s["connected"], "disconnection")
    b.peer.uid, b.peer.beating = 99, True
    state = await b.state(lambda s: s["connected"] and s["uid"], "the new uid")
    assert (state["uid"], state["clash"]) == (f"{99:016x}", None)


@pytest.mark.parametrize(
    ("change", "kind", "autopilot"),
    [({"mav_type": ROVER}, "rover", "ardupilot"), ({"autopilot": PX4}, "copter", "px4")],
    ids=["type", "stack"],
)
async def test_another_kind_under_the_same_id(
    bench: StartBench, change: dict[str, Any], kind: str, autopilot: str
) -> None:
    b = await (await bench()).connected()
    for name, value in change.items():
        setattr(b.peer, name, value)
    state = await b.state(lambda s: (s["kind"], s["autopilot"]) == (kind, autopilot), "the other rules")
    assert state["sysid"] == 1
    await b.event(f"{autopilot} {kind} with system id 1")


async def test_another_autopilot_on_the_link_is_said_once_and_never_taken_for_ours(bench: StartBench) -> None:
    b = await (await bench(sysid=1)).connected()
    other = Packer(b.peer.dialect, 2, 1)
    armed = {"type": 2, "autopilot": ARDUPILOT, "base_mode": 129, "custom_mode": 4}
    for _ in range(30):
        b.peer.raw(other.pack("HEARTBEAT", **armed))
    await b.event("another autopilot (2/1) is on this link", severity="warning")
    b.peer.beating = False
    await b.state(lambda s: not s["connected"], "disconnection")
    for _ in range(30):
        b.peer.raw(other.pack("HEARTBEAT", **armed))
    b.peer.beating = True
    state = await b.state(lambda s: s["connected"], "our own again")
    assert (state["sysid"], state["armed"], state["mode"]) == (1, False, "STABILIZE")
    assert all(s["sysid"] in (None, 1) for s in b.states.objects())
    assert sum("another autopilot" in e["text"] for e in b.events.objects()) == 1


async def test_the_chosen_system_is_waited_for(bench: StartBench, peer: StartPeer) -> None:
    one = await peer(sysid=5)
    b = await bench(one, settings={"sysid": 6})
    await b.event("another autopilot (5/1) is on this link", severity="warning")
    assert b.states.objects()[-1]["sysid"] is None
    assert one.heard("HEARTBEAT")[0].source == (6, 191)
    one.packer = Packer(one.dialect, 6, 1)
    assert (await b.state(lambda s: s["connected"], "system 6"))["sysid"] == 6


async def test_ground_stations_and_gimbals_are_no_autopilots(bench: StartBench, peer: StartPeer) -> None:
    one = await peer(sysid=3)
    one.beating = False
    b = await bench(one)
    await b.state(lambda s: s["link"] == "up", "link")
    await one.until(lambda: bool(one.heard("HEARTBEAT")), "companion")
    for source, mav_type, stack in (
        ((255, 190), GCS, INVALID),
        ((254, 190), GCS, GENERIC),
        ((3, 154), GIMBAL, GENERIC),
        ((3, 191), ONBOARD_CONTROLLER, INVALID),
        ((4, 1), QUADROTOR, INVALID),
    ):
        one.raw(Packer(one.dialect, *source).pack("HEARTBEAT", type=mav_type, autopilot=stack))
    one.beating = True
    state = await b.state(lambda s: s["sysid"], "an autopilot")
    assert (state["sysid"], state["compid"]) == (3, 1)
    await b.event("ardupilot copter with system id 3")
    assert [e["detail"]["sysid"] for e in b.events.objects() if e["kind"] == "autopilot"] == [3]


async def test_the_companion_speaks_as_the_vehicle_s_own_component(bench: StartBench, peer: StartPeer) -> None:
    one = await peer(sysid=42)
    b = await (await bench(one)).connected()
    known = len(one.told)
    for number, name in ((5, "LOITER"), (4, "GUIDED"), (9, "LAND")):  # a change of mode starts nothing again
        one.mode = number
        await b.event(f"mode {name}")
    await one.until(lambda: len([t for t in one.told[known:] if t.name == "HEARTBEAT"]) >= 2, "two heartbeats")
    assert "HEARTBEAT" in [t.name for t in one.told[:3]]  # said as soon as the link is open
    assert {t.source for t in one.told[known:]} == {(42, 191)}
    beat = next(t for t in one.told[known:] if t.name == "HEARTBEAT")
    assert (beat.fields["type"], beat.fields["autopilot"]) == (ONBOARD_CONTROLLER, INVALID)
    seqs = [t.seq for t in one.told[known:]]
    assert seqs == [(seqs[0] + n) % 256 for n in range(len(seqs))]


@pytest.mark.parametrize("sysid", [0, 256, -1])
def test_a_system_id_that_cannot_be(net: Net, sysid: int) -> None:
    session, _ = net.router()
    with pytest.raises(BadConfig) as e:
        Onboard(session, OnboardSettings(link="udpin:127.0.0.1:0", name="quad1", sysid=sysid))
    assert e.value.detail["field"] == "sysid"
