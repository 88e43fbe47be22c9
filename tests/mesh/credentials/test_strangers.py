"""Who has no certificate of the fleet's, or none any more, gets no session; garbage on the ports harms nobody."""

from __future__ import annotations

import contextlib
import random
import shutil
import socket
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import zenoh

from mesh.credentials.ca import Authority
from zmav.errors import BadConfig, SessionError
from zmav.session import SessionSettings, open_session
from zmav.trust.certificate import Role

if TYPE_CHECKING:
    from tests.mesh.credentials.conftest import Door, Fleet

RawClient = Callable[..., zenoh.Session]


ROSTER = "zmav/alpha/@fleet/roster"


@pytest.fixture
def door(fleet: Fleet) -> Door:
    fleet.issue(quad1=Role.VEHICLE, ops=Role.OPERATOR, view=Role.VIEWER)
    return fleet.router("quad1")


def showing(folder: Path, ca: Path | None = None) -> dict[str, Any]:
    """Zenoh's settings of a client that shows the certificate in a folder, whatever it is."""
    return {
        "root_ca_certificate": str(ca or folder / "ca.pem"),
        "connect_certificate": str(folder / "cert.pem"),
        "connect_private_key": str(folder / "key.pem"),
        "enable_mtls": True,
        "verify_name_on_connect": False,
    }


def linked(session: zenoh.Session) -> bool:
    return bool(list(session.info.routers_zid()))


@pytest.mark.parametrize("protocol", ["tls", "quic"])
def test_a_stranger_gets_no_session(
    fleet: Fleet, door: Door, raw_client: RawClient, protocol: str, tmp_path: Path
) -> None:
    endpoint = getattr(door, protocol)
    ca = fleet.authority.folder / "ca.pem"
    others = Authority.create(tmp_path / "others", "alpha").issue("ops", Role.OPERATOR)
    expired = fleet.authority.issue("old", Role.OPERATOR, days=-0.5, out=tmp_path / "old")
    for shown in (
        {"root_ca_certificate": str(ca), "verify_name_on_connect": False},  # no certificate
        showing(others, ca),  # another authority's, for the same fleet and name
        showing(expired),
    ):
        with pytest.raises(zenoh.ZError, match="Unable to connect"):
            raw_client(endpoint, **shown)
    assert linked(raw_client(endpoint, **showing(fleet.members["view"]))), "and this is not why"


@pytest.mark.parametrize("protocol", ["tls", "quic"])
def test_we_do_not_speak_to_a_router_of_strangers_either(fleet: Fleet, tmp_path: Path, protocol: str) -> None:
    """A client's own credentials judge the router, too."""
    fleet.issue(quad1=Role.VEHICLE)
    other = Authority.create(tmp_path / "others", "alpha").issue("quad1", Role.VEHICLE)
    with pytest.raises(SessionError, match="no Zenoh router answers"):
        open_session(SessionSettings(connect=[getattr(fleet.router("quad1"), protocol)], credentials=str(other)))


def test_a_plain_port_is_not_offered_beyond_loopback(fleet: Fleet, door: Door) -> None:
    """Plain TCP to the port that speaks TLS, and the other way round, is no way in."""
    for endpoint in (door.tls.replace("tls/", "tcp/"), door.local.replace("tcp/", "tls/")):
        with pytest.raises(SessionError, match="no Zenoh router answers"):
            open_session(SessionSettings(connect=[endpoint], credentials=str(fleet.members["view"])))


def test_a_member_that_was_revoked_gets_nothing_but_rosters_from_a_router_that_knows(fleet: Fleet) -> None:
    fleet.issue(quad1=Role.VEHICLE, view=Role.VIEWER, ops=Role.OPERATOR)
    fleet.authority.revoke("ops")
    door = fleet.router("quad1")
    home = fleet.home(door)
    for endpoint in (door.tls, door.quic):
        out, member = fleet.open("ops", endpoint), fleet.open("view", endpoint)
        heard: list[zenoh.Sample] = []
        out.declare_subscriber("zmav/**", heard.append, allowed_origin=zenoh.Locality.REMOTE)
        out.declare_queryable(ROSTER, lambda query: query.reply(ROSTER, b"a lie"))
        for key in ("zmav/alpha/quad1/do/arm", "zmav/alpha/quad1/state", "@/*/router"):
            out.get(key, lambda reply: None, timeout=1.0)
        out.put("zmav/alpha/quad1/setpoint/x", b"")
        out.put("zmav/alpha/@fleet/origin", b"")
        assert list(out.get("zmav/alpha/quad1/msg/X", timeout=0.3)) == []
        home.session.put("zmav/alpha/quad1/state", b"")
        (answer,) = member.get("zmav/alpha/quad1/msg/END", timeout=5.0)
        assert answer.ok is not None
        assert home.asked.until("zmav/alpha/quad1/msg/END") == set()
        assert {key for key in home.put.keys if key != "zmav/alpha/quad1/state"} == set()
        assert heard == []
    answers = home.session.get(ROSTER, timeout=5.0, consolidation=zenoh.ConsolidationMode.NONE)
    assert [answer.ok.payload.to_bytes() for answer in answers if answer.ok] == [b"home"]


def test_a_key_that_others_can_read_is_not_used(fleet: Fleet) -> None:
    fleet.issue(view=Role.VIEWER)
    (fleet.members["view"] / "key.pem").chmod(0o644)
    with pytest.raises(BadConfig, match="chmod 600"):
        open_session(SessionSettings(connect=["tls/127.0.0.1:1"], credentials=str(fleet.members["view"])))


def test_garbage_and_half_handshakes_leave_members_in_peace(fleet: Fleet, door: Door) -> None:
    """Random bytes, connections that say nothing, and a hello without an end, on both ports."""
    home, view = fleet.home(door), fleet.open("view", door.quic)
    noise = random.Random(7)
    tls, quic = (int(e.partition("?")[0].rpartition(":")[2]) for e in (door.tls, door.quic))
    held = [socket.create_connection(("127.0.0.1", tls), 5.0) for _ in range(30)]
    for number, connection in enumerate(held):
        connection.sendall((b"", noise.randbytes(700), b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03")[number % 3])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as shooter:
        for size in (0, 1, 20, 1200, 1472, 9000):
            for first in (0x00, 0x40, 0xC0, 0xFF):
                shooter.sendto(bytes([first]) + noise.randbytes(size), ("127.0.0.1", quic))
    for session in (view, fleet.open("ops", door.quic)):  # who was in, and who comes meanwhile
        (answer,) = session.get("zmav/alpha/quad1/msg/X", timeout=10.0)
        assert answer.ok is not None
    for connection in held:
        connection.close()
    (answer,) = patiently(fleet, door.tls).get("zmav/alpha/quad1/msg/X", timeout=10.0)
    assert answer.ok is not None
    assert home.asked.keys


def patiently(fleet: Fleet, endpoint: str) -> zenoh.Session:
    """Zenoh takes a tenth of a second over each TLS handshake that fails, one after the other."""
    for _ in range(20):
        with contextlib.suppress(SessionError):
            return fleet.open("ops", endpoint)
    pytest.fail(f"nobody gets in at {endpoint} any more")


def test_a_folder_is_taken_as_a_whole(fleet: Fleet, tmp_path: Path) -> None:
    """Another's certificate beside our key, or our certificate beside another authority, is said at once."""
    fleet.issue(one=Role.VIEWER, two=Role.VIEWER)
    mixed = tmp_path / "mixed"
    shutil.copytree(fleet.members["one"], mixed)
    shutil.copy(fleet.members["two"] / "cert.pem", mixed)
    with pytest.raises(BadConfig, match="is not the key of"):
        open_session(SessionSettings(connect=["tls/127.0.0.1:1"], credentials=str(mixed)))
