"""Calls by multicast: which sockets they leave from, and when."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from ipaddress import ip_interface

import pytest
import zenoh

from mesh.radios import FoundRadio
from mesh.scouting import CALL, FOR_S, Calls
from zmav.config import Radio
from zmav.session import SessionSettings, open_session

LOOPBACK = FoundRadio(Radio(interface="lo", address="127.0.0.1"), ip_interface("127.0.0.1/8"), present=True)
ELSEWHERE = FoundRadio(Radio(interface="wlan9", address="10.99.0.1"), ip_interface("10.99.0.1/8"), present=True)


def router(group: str) -> zenoh.Session:
    scouting = {
        "enabled": "true",
        "interface": '"lo"',
        "address": f'"{group}"',
        "listen": "{router: true, peer: false, client: false}",
        "autoconnect": '{router: ["router"], peer: [], client: []}',
        "ttl": "1",
    }
    cfg = tuple(f"scouting/multicast/{name}:{value}" for name, value in scouting.items())
    return open_session(SessionSettings(mode="router", listen=("tcp/127.0.0.1:0",), cfg=cfg))


@pytest.fixture
def heard() -> Iterator[socket.socket]:
    """What is sent to a group of the test's own."""
    group = "224.0.0.225"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as found:
        found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # Zenoh listens there, too
        found.bind((group, 0))
        found.setsockopt(
            socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(group) + socket.inet_aton("127.0.0.1")
        )
        found.settimeout(10.0)
        yield found


def test_our_calls_are_zenoh_s_own_and_leave_from_its_socket(heard: socket.socket) -> None:
    port = heard.getsockname()[1]
    with router(f"224.0.0.225:{port}"):
        theirs = heard.recvfrom(1500)
        calls = Calls([LOOPBACK], 0.0, heard.getsockname())
        assert calls.call(0.0) >= 1  # those of a router that was closed stay open for a while
        assert heard.recvfrom(1500) == theirs == (CALL, theirs[1])
        calls.close()


def test_it_calls_after_the_start_and_after_a_loss_only(heard: socket.socket) -> None:
    with router(f"224.0.0.225:{heard.getsockname()[1]}"):
        calls = Calls([LOOPBACK], 100.0, heard.getsockname())
        assert calls.call(100.0 + FOR_S - 0.1) >= 1
        assert calls.call(100.0 + FOR_S) == 0
        calls.lost(500.0)
        assert calls.call(500.0) >= 1
        calls.close()


def test_other_sockets_of_the_process_are_left_alone() -> None:
    before = Calls([LOOPBACK], 0.0)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("0.0.0.0", 0))
        calls = Calls([ELSEWHERE, LOOPBACK], 0.0)
        assert calls.call(0.0) == before.call(0.0)
        assert Calls([ELSEWHERE], 0.0).call(0.0) == 0
        for each in (calls, before):
            each.close()
        assert other.fileno() >= 0
