"""What a member that is no vehicle, or a program on loopback, says as if it were one: nobody on the ground believes it.

The doors let little of it in; here it is said behind them, as by a relay that was taken over.
"""

from __future__ import annotations

import asyncio
import socket
import threading
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import zenoh
from mcap.reader import make_reader

import zmav
from agents.follower.slot import Slot
from ground.feed import Feed, Origin
from ground.gcs.bridge import Bridge, BridgeSettings
from ground.gcs.options import Options, parse_endpoint
from ground.http.gateway import Gateway
from ground.record.folder import Folder
from ground.record.recorder import Recorder, Wanted
from ground.record.storage import RecordingSettings
from tests.waiting import until
from zmav import keys
from zmav.errors import Refused
from zmav.mavlink import Packer, load_dialect
from zmav.session import SessionSettings
from zmav.trust.certificate import Role
from zmav.trust.credentials import Credentials

if TYPE_CHECKING:
    from tests.mesh.credentials.conftest import Door, Fleet

PATIENCE_S = 30.0
VEHICLE, VIEWER, LATER, NOBODY = "quad1", "view", "quad9", "ghost"
TRUE, FORGED = 0x01020304, 0x06070809
"""latitudes"""
BLOCK = zenoh.CongestionControl.BLOCK


@pytest.fixture
def door(fleet: Fleet) -> Door:
    fleet.issue(**{VEHICLE: Role.VEHICLE, VIEWER: Role.VIEWER, "ops": Role.OPERATOR})
    return fleet.router(VEHICLE)


def client(fleet: Fleet, door: Door) -> zmav.Client:
    return zmav.open(
        fleet="alpha", settings=SessionSettings(connect=[door.local], credentials=str(fleet.members["ops"]))
    )


class Liar:
    """Says what a vehicle says, under any name; its last word is the vehicle's own."""

    def __init__(self, session: zenoh.Session) -> None:
        self.session, self._dialect, self._tokens = session, load_dialect(), list[zenoh.LivelinessToken]()

    def frame(self, name: str, lat: int) -> None:
        packer = Packer(self._dialect, 1, 1)
        zero = dict.fromkeys(("time_boot_ms", "lon", "alt", "relative_alt", "vx", "vy", "vz", "hdg"), 0)
        frame = packer.pack("GLOBAL_POSITION_INT", lat=lat, **zero)
        key = keys.RX.key("alpha", name, sys=1, comp=1, msg="GLOBAL_POSITION_INT")
        self.session.put(key, frame, congestion_control=BLOCK)

    def token(self, name: str) -> None:
        about = {"role": keys.VEHICLE, "sys": 1, "autopilot": "ardupilot", "uid": name, "instance": name}
        self._tokens.append(self.session.liveliness().declare_token(keys.ALIVE.key("alpha", name, **about)))

    def slot(self, name: str) -> None:
        key = keys.SLOT.key("alpha", name, target="rover1", slot="above", since=1, instance=name)
        self._tokens.append(self.session.liveliness().declare_token(key))


@pytest.fixture
def liar(fleet: Fleet, door: Door) -> Liar:
    return Liar(fleet.open(None, door.unix))


async def test_frames_under_a_name_that_is_no_vehicles_reach_no_reader(
    fleet: Fleet, door: Door, liar: Liar, tmp_path: Path
) -> None:
    """The feed of bridge, gateway and viewer; subscriptions; the gateway, a station behind the bridge, the recorder."""
    fed: list[Origin] = []
    station = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    station.bind(("127.0.0.1", 0))
    station.settimeout(PATIENCE_S)
    to = f"127.0.0.1:{station.getsockname()[1]}"
    endpoint = parse_endpoint("udp", to, Options())
    folder = Folder(tmp_path / "recorded")
    async with (
        client(fleet, door) as z,
        Gateway(z) as gateway,
        Bridge(z, BridgeSettings(endpoints=(endpoint,))),
        Recorder(z, folder, RecordingSettings(), Wanted(name="ops"), lambda line: None) as recorder,
        z.subscribe("zmav/alpha/*/mav/rx/**") as read,
    ):
        with Feed(z.session, z.is_vehicle, lambda origin, frame: fed.append(origin), "alpha"):
            liar.token(VEHICLE)
            await until(lambda: [v.name for v in z.fleet()] == [VEHICLE], "the vehicle")

            def tell() -> bool:
                for name in (VIEWER, NOBODY, "ops"):
                    liar.frame(name, lat=FORGED)
                liar.session.put(keys.FLEET.key("alpha", topic=keys.ROSTER), b"{}", congestion_control=BLOCK)
                liar.frame(VEHICLE, lat=TRUE)
                return bool(fed and gateway.kept() and recorder.storage.counts.written)

            await until(tell, "the vehicle's own frames")
            sample = await asyncio.wait_for(read.get(), PATIENCE_S)
            shown = b""
            while _bytes(TRUE) not in shown:
                shown += await asyncio.to_thread(station.recv, 4096)
            assert _bytes(FORGED) not in shown
        assert str(sample.key_expr).split("/")[2] == VEHICLE and read.bad
        assert {origin.vehicle for origin in fed} == {VEHICLE}
        assert {kept.origin.vehicle for kept in gateway.kept()} == {VEHICLE}
        assert recorder.storage.counts.written
    station.close()
    assert recorded(folder) == {VEHICLE}


async def test_only_vehicles_are_listed_and_one_that_was_admitted_since_is_by_its_certificate(
    fleet: Fleet, door: Door, liar: Liar
) -> None:
    async with client(fleet, door) as z:
        fleet.issue(**{LATER: Role.VEHICLE})
        der = Credentials.load(fleet.members[LATER]).certificate.der
        asked = threading.Event()
        key = keys.CERTIFICATE.key("alpha", LATER)

        def answer(query: zenoh.Query) -> None:
            with query:
                query.reply(key, der)
                asked.set()

        liar.session.declare_queryable(key, answer)
        for name in (VIEWER, NOBODY, LATER, VEHICLE):
            liar.token(name)
        await until(lambda: [v.name for v in z.fleet()] == [VEHICLE, LATER], "those two")
        assert asked.is_set()
        assert not z.present(VIEWER, "alpha") and not z.present(NOBODY, "alpha")


async def test_a_place_beside_a_target_is_a_vehicles(fleet: Fleet, door: Door, liar: Liar) -> None:
    for name in (VIEWER, NOBODY):
        liar.slot(name)
    async with client(fleet, door) as z:
        async with Slot(z.session, z.is_vehicle, "alpha", "quad2", "rover1", "above") as slot:
            assert not slot.better
        liar.slot(VEHICLE)
        with pytest.raises(Refused, match=f"{VEHICLE} keeps the place"):
            async with Slot(z.session, z.is_vehicle, "alpha", "quad2", "rover1", "above"):
                pass


def _bytes(number: int) -> bytes:
    return number.to_bytes(4, "little")


def recorded(folder: Folder) -> set[str]:
    """Whose frames, and other topics of the fleet, are in the files."""
    found = set()
    for path in folder.recordings():
        with path.open("rb") as file:
            topics = [c.topic.split("/") for _, c, _ in make_reader(file).iter_messages()]
        found |= {topic[2] for topic in topics if "mav" in topic or topic[2].startswith("@")}
    return found
