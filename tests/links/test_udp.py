"""UDP links against real sockets: who is heard, who is answered, one local port for life, and what goes wrong."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.ports import free_udp_ports
from zmav.links import Link, LinkState, UdpInLink, UdpOutLink, open_link
from zmav.links.base import MUCH

if TYPE_CHECKING:
    from tests.links.conftest import Watch, Watched

PATIENCE_S = 30.0
Peer = Callable[..., socket.socket]


@pytest.fixture
def peer() -> Iterator[Peer]:
    """Makes UDP sockets on free loopback ports, with a time limit on their reads."""
    made: list[socket.socket] = []

    def make(port: int = 0) -> socket.socket:
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        made.append(sock)
        sock.settimeout(PATIENCE_S)
        sock.bind(("127.0.0.1", port))
        return sock

    yield make
    for sock in made:
        sock.close()


def port_of(sock: socket.socket) -> int:
    return int(sock.getsockname()[1])


def listen(watch: Watch) -> tuple[Watched, UdpInLink, tuple[str, int]]:
    """A udpin link on a free port: under watch, itself, its address."""
    watched = watch("udpin:127.0.0.1:0")
    watched.expect_state(LinkState.CONNECTING, "listening on 127.0.0.1:")
    assert isinstance(watched.link, UdpInLink)
    assert watched.link.local_address is not None
    return watched, watched.link, watched.link.local_address[:2]


def test_udpin_is_up_with_the_first_datagram_and_answers(watch: Watch, peer: Peer) -> None:
    watched, link, address = listen(watch)
    assert link.state is LinkState.CONNECTING
    assert link.send(b"too early") is False
    assert link.counters.tx_dropped == 1
    vehicle = peer()
    vehicle.sendto(b"hello", address)
    watched.expect_data(b"hello")
    watched.expect_state(LinkState.UP, f"hearing 127.0.0.1:{port_of(vehicle)}")
    assert link.send(b"answer") is True
    assert vehicle.recvfrom(100) == (b"answer", address)
    counters = link.counters
    assert (counters.rx_bytes, counters.tx_bytes, counters.tx_dropped, counters.opens) == (5, 6, 1, 1)
    assert counters.rx_buffer > 0


def test_udpin_delivers_each_datagram_by_itself(watch: Watch, peer: Peer) -> None:
    watched, _, address = listen(watch)
    vehicle = peer()
    datagrams = [b"a", b"", b"bb", bytes(range(256)) * 200, b"c"]  # an empty one says nothing; 51,200 bytes fit
    for datagram in datagrams:
        vehicle.sendto(datagram, address)
    watched.until(lambda: len(watched.pieces) >= 4, "four datagrams")
    assert watched.pieces == [datagram for datagram in datagrams if datagram]


def test_what_comes_fast_is_taken_together_where_it_may_lie(watch: Watch, peer: Peer) -> None:
    watched, link, address = listen(watch)
    link.patience = lambda: 1.0
    vehicle = peer()
    for datagram in (b"a", b"b", b"c", b"d"):
        vehicle.sendto(datagram, address)
    watched.expect_data(b"abcd")
    assert watched.pieces[-1] in (b"bcd", b"cd"), "what came while it was waited"


def test_a_backlog_is_taken_together_where_it_may_be(watch: Watch, peer: Peer) -> None:
    watched, link, address = listen(watch)
    link.joins_s, vehicle, took = PATIENCE_S, peer(), link._on_data
    reads, sent = threading.Event(), threading.Event()

    def slow(data: bytes) -> None:
        reads.set()
        sent.wait(PATIENCE_S)
        took(data)

    link._on_data = slow
    vehicle.sendto(b"a", address)
    assert reads.wait(PATIENCE_S)
    for datagram in (b"b", b"c", b"d"):
        vehicle.sendto(datagram, address)
    sent.set()
    watched.expect_data(b"abcd")
    assert watched.pieces == [b"a", b"bcd"]


def test_who_hurries_waits_for_no_nap(watch: Watch, peer: Peer) -> None:
    watched, link, address = listen(watch)
    link.patience, link.nap = lambda: 30.0, 30.0
    vehicle = peer()
    for datagram in (b"a", b"b"):
        vehicle.sendto(datagram, address)
    watched.expect_data(b"a")
    link.hurry()
    watched.expect_data(b"ab")


def test_the_nap_is_shorter_where_much_comes(watch: Watch, peer: Peer) -> None:
    """A receive buffer of the usual size holds what comes meanwhile."""
    watched, link, address = listen(watch)
    link.patience = lambda: 0.2
    vehicle, sent, until = peer(), 0, time.monotonic() + 1.0
    while time.monotonic() < until:
        vehicle.sendto(b"x" * 200, address)
        sent += 200
        time.sleep(0.0005)
    watched.expect_data(b"x" * sent)
    assert max(map(len, watched.pieces)) < 4 * MUCH


def test_udpin_sends_to_all_heard_lately(watch: Watch, peer: Peer) -> None:
    watched, link, address = listen(watch)
    vehicles = [peer() for _ in range(3)]
    for vehicle in vehicles:
        vehicle.sendto(b"x", address)
    watched.expect_data(b"xxx")
    assert link.send(b"all") is True
    assert [vehicle.recv(10) for vehicle in vehicles] == [b"all"] * 3
    assert link.counters.tx_bytes == 9


def test_udpin_remembers_sixteen_the_longest_silent_gives_way(watch: Watch, peer: Peer) -> None:
    watched, link, address = listen(watch)
    vehicles = [peer() for _ in range(17)]
    for count, vehicle in enumerate(vehicles, 1):
        vehicle.sendto(b"x", address)
        watched.expect_data(b"x" * count)  # one after the other
    assert set(link.peers) == {vehicle.getsockname() for vehicle in vehicles[1:]}
    vehicles[0].sendto(b"x", address)
    watched.expect_data(b"x" * 18)
    assert set(link.peers) == {vehicle.getsockname() for vehicle in (vehicles[0], *vehicles[2:])}


def test_udpin_forgets_the_silent_but_never_the_last(watch: Watch, peer: Peer) -> None:
    watched, link, address = listen(watch)
    first, second = peer(), peer()
    first.sendto(b"1", address)
    watched.expect_data(b"1")
    link.peer_life = 0.0  # anyone who was heard before now has been silent for too long
    second.sendto(b"2", address)
    watched.expect_data(b"12")
    assert link.peers == (second.getsockname(),)
    assert link.send(b"still there?") is True
    assert second.recv(100) == b"still there?"


def test_udpin_port_in_use_then_freed(watch: Watch, peer: Peer) -> None:
    holder = peer()
    port = port_of(holder)
    watched = watch(f"udpin:127.0.0.1:{port}")
    after = watched.expect_state(LinkState.DOWN, f"port {port} on 127.0.0.1 is held by another program")
    assert watched.link.counters.last_error == watched.states[after - 1][1]
    assert watched.link.send(b"x") is False
    holder.close()
    watched.expect_state(LinkState.CONNECTING, "listening", after)
    peer().sendto(b"here", ("127.0.0.1", port))
    watched.expect_data(b"here")


def test_udpin_does_not_share_its_port(watch: Watch) -> None:
    """Also not with a program that asks to share it, as pymavlink does: the datagrams would go to only one of them."""
    _, _, address = listen(watch)
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as thief:
        thief.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        with pytest.raises(OSError, match="in use"):
            thief.bind(address)


def test_udpin_of_a_foreign_address_says_what_to_use(watch: Watch) -> None:
    watched = watch("udpin:192.0.2.1:14550")
    watched.expect_state(LinkState.DOWN, "use udpout:192.0.2.1:14550")


def test_localhost_listens_where_autopilots_send(watch: Watch) -> None:
    watch("udpin:localhost:0").expect_state(LinkState.CONNECTING, "listening on 127.0.0.1:")


def test_unknown_host_is_down_and_retried(watch: Watch) -> None:
    watched = watch("udpout:no-such-host.invalid:14550")
    watched.expect_state(LinkState.DOWN, "cannot resolve 'no-such-host.invalid'")
    assert watched.link.send(b"x") is False


def test_udpout_both_ways_and_from_whatever_port(watch: Watch, peer: Peer) -> None:
    vehicle, elsewhere = peer(), peer()
    watched = watch(f"udpout:127.0.0.1:{port_of(vehicle)}")
    watched.expect_state(LinkState.UP, f"sending to 127.0.0.1:{port_of(vehicle)} from port ")
    link = watched.link
    assert isinstance(link, UdpOutLink)
    assert link.send(b"hello") is True
    data, source = vehicle.recvfrom(100)
    assert (data, source) == (b"hello", link.local_address)
    vehicle.sendto(b"from the same port", source)
    watched.expect_data(b"from the same port")
    elsewhere.sendto(b", from another", source)
    watched.expect_data(b"from the same port, from another")


def test_udpout_to_loopback_is_not_reachable_from_outside(watch: Watch, peer: Peer) -> None:
    watched = watch(f"udpout:127.0.0.1:{port_of(peer())}")
    watched.expect_state(LinkState.UP)
    assert isinstance(watched.link, UdpOutLink)
    assert watched.link.local_address is not None
    assert watched.link.local_address[0] == "127.0.0.1"


def test_udpout_refused_by_icmp_goes_on_from_the_same_port(watch: Watch, peer: Peer) -> None:
    port = free_udp_ports(1)
    watched = watch(f"udpout:127.0.0.1:{port}")
    watched.expect_state(LinkState.UP)
    assert isinstance(watched.link, UdpOutLink)
    before = watched.link.local_address
    assert before is not None
    for _ in range(20):  # each is answered by "port unreachable"
        assert watched.link.send(b"anybody?") is True
    vehicle = peer(port)
    assert watched.link.send(b"now?") is True
    assert vehicle.recvfrom(100) == (b"now?", before)
    vehicle.sendto(b"yes", before)
    watched.expect_data(b"yes")
    vehicle.close()
    assert watched.link.send(b"gone again") is True
    again = peer(port)
    assert watched.link.send(b"back?") is True
    assert again.recvfrom(100) == (b"back?", before)
    assert [state for state, _ in watched.states] == [LinkState.CONNECTING, LinkState.UP]


def test_udpout_from_a_chosen_port(watch: Watch, peer: Peer) -> None:
    vehicle, holder = peer(), peer()
    local = port_of(holder)
    watched = watch(f"udpout:127.0.0.1:{port_of(vehicle)}?local={local}")
    after = watched.expect_state(LinkState.DOWN, f"port {local} on 127.0.0.1 is held by another program")
    holder.close()
    watched.expect_state(LinkState.UP, f"from port {local}", after)
    assert watched.link.send(b"hello") is True
    assert vehicle.recvfrom(100) == (b"hello", ("127.0.0.1", local))


def test_a_datagram_too_long_is_dropped_and_told(watch: Watch, peer: Peer) -> None:
    watched = watch(f"udpout:127.0.0.1:{port_of(peer())}")
    watched.expect_state(LinkState.UP)
    assert watched.link.send(bytes(70000)) is False
    assert watched.link.counters.tx_dropped == 1
    assert watched.link.counters.last_error == "Message too long"
    assert watched.link.send(b"short") is True


def test_burst_is_received_whole(watch: Watch, peer: Peer) -> None:
    watched, link, address = listen(watch)
    count = min(4000, link.counters.rx_buffer // 2048)  # what surely fits, in case the system grants little
    vehicle = peer()
    for number in range(count):
        vehicle.sendto(number.to_bytes(45, "big"), address)
    watched.until(lambda: len(watched.pieces) >= count, f"{count} datagrams")
    assert watched.pieces == [number.to_bytes(45, "big") for number in range(count)]
    assert link.counters.rx_dropped == 0


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells")
def test_what_the_kernel_drops_is_counted(peer: Peer) -> None:
    link = open_link("udpin:127.0.0.1:0")
    assert isinstance(link, UdpInLink)
    go_on, listening, heard, last = threading.Event(), threading.Event(), [], threading.Event()

    def on_data(data: bytes) -> None:
        go_on.wait(PATIENCE_S)  # a reader that does not come to read
        heard.append(data)
        if data == b"last":
            last.set()

    def on_state(state: LinkState, detail: str) -> None:
        if detail.startswith("listening"):
            listening.set()

    link.start(on_data, on_state)
    assert listening.wait(PATIENCE_S)
    vehicle, sent = peer(), 0
    assert link.local_address is not None
    while sent < 100_000 and link.counters.rx_dropped < 50:
        vehicle.sendto(bytes(8000), link.local_address)
        sent += 1
    dropped = link.counters.rx_dropped
    assert dropped >= 50
    go_on.set()
    while not last.wait(0.05):  # sent until there is room for it
        vehicle.sendto(b"last", link.local_address)
    link.close()
    assert link.counters.rx_dropped >= dropped  # the last word, kept
    assert len([data for data in heard if data != b"last"]) == sent - dropped


def test_many_threads_send_at_once(watch: Watch, peer: Peer) -> None:
    vehicle = peer()
    vehicle.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
    watched = watch(f"udpout:127.0.0.1:{port_of(vehicle)}")
    watched.expect_state(LinkState.UP)

    def send() -> None:
        for _ in range(25):
            assert watched.link.send(b"12345")

    threads = [threading.Thread(target=send) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [vehicle.recv(10) for _ in range(200)] == [b"12345"] * 200
    assert watched.link.counters.tx_bytes == 1000


def test_ipv6(watch: Watch) -> None:
    try:
        vehicle = socket.socket(socket.AF_INET6, socket.SOCK_DGRAM)
        vehicle.bind(("::1", 0))
    except OSError:
        pytest.skip("no IPv6 here")
    with closing(vehicle):
        vehicle.settimeout(PATIENCE_S)
        watched = watch(f"udpout:[::1]:{port_of(vehicle)}")
        watched.expect_state(LinkState.UP, f"sending to [::1]:{port_of(vehicle)}")
        assert watched.link.send(b"six") is True
        data, source = vehicle.recvfrom(100)
        assert data == b"six"
        vehicle.sendto(b"6", source)
        watched.expect_data(b"6")
        back = watch("udpin:[::1]:0")
        back.expect_state(LinkState.CONNECTING, "listening on [::1]:")


@pytest.mark.parametrize("ours", ["udpin", "udpout"])
def test_speaks_with_pymavlink(watch: Watch, ours: str) -> None:
    from pymavlink import mavutil

    port = free_udp_ports(1)
    watched = watch(f"{ours}:127.0.0.1:{port}")
    if ours == "udpin":
        watched.expect_state(LinkState.CONNECTING, "listening")
    theirs = mavutil.mavlink_connection(f"{'udpout' if ours == 'udpin' else 'udpin'}:127.0.0.1:{port}", source_system=7)
    heartbeat = theirs.mav.heartbeat_encode(2, 3, 0, 0, 3)
    with closing(theirs):
        if ours == "udpout":
            watched.expect_state(LinkState.UP)
            assert watched.link.send(heartbeat.pack(theirs.mav)) is True
            assert theirs.recv_match(type="HEARTBEAT", blocking=True, timeout=PATIENCE_S).get_srcSystem() == 7
        theirs.mav.heartbeat_send(2, 3, 0, 0, 3)
        watched.until(lambda: len(watched.data) > 0, "heartbeat")
        assert watched.data[0] in (0xFD, 0xFE)
        if ours == "udpin":
            assert watched.link.send(watched.data) is True
            assert theirs.recv_match(type="HEARTBEAT", blocking=True, timeout=PATIENCE_S).get_srcSystem() == 7


NO_ROUTE = """
import subprocess
from zmav.links import LinkState, open_link

def ip(*words):
    subprocess.run(["ip", *words], check=True)

def wait(state, words=""):
    with link._changed:
        assert link._changed.wait_for(lambda: link.state is state and words in link.detail, 30), repr(link)

ip("link", "add", "wifi0", "type", "veth", "peer", "name", "wifi1")
ip("link", "set", "wifi1", "up")
ip("address", "add", "10.9.9.1/24", "dev", "wifi0")
link = open_link("udpout:10.9.9.2:14550")
link.start(lambda data: None, lambda state, detail: None)
wait(LinkState.DOWN, "no way to 10.9.9.2:14550: Network is unreachable")
port = link.local_address[1]
assert link.send(b"x") is False
for round in range(2):
    ip("link", "set", "wifi0", "up")
    wait(LinkState.UP)
    assert link.send(b"x") is True
    ip("link", "set", "wifi0", "down")
    assert link.send(b"x") is False
    wait(LinkState.DOWN, "Network is unreachable")
assert link.local_address[1] == port
assert link.counters.opens == 2
assert link.counters.tx_dropped == 3
link.close()
"""


@pytest.mark.root
def test_udpout_without_a_route_is_down_until_there_is_one(root: Path) -> None:
    """In a network namespace of its own; the local port stays the same throughout."""
    try:
        subprocess.run(["unshare", "-n", "ip", "link"], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("no network namespaces here")
    done = subprocess.run(
        ["unshare", "-n", sys.executable, "-c", NO_ROUTE], cwd=root, capture_output=True, text=True, timeout=100
    )
    assert done.returncode == 0, done.stderr


def test_link_is_a_link(watch: Watch) -> None:
    assert isinstance(listen(watch)[1], Link)
