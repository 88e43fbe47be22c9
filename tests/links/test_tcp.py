"""TCP links against real sockets: both ways, peers that come and go, that never read, that vanish without a word."""

from __future__ import annotations

import select
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from zmav.links import LinkState, open_link, tcp

if TYPE_CHECKING:
    from tests.links.conftest import Watch

PATIENCE_S = 30.0
Server = Callable[..., socket.socket]
Frames = Callable[[int], list[bytes]]


@pytest.fixture
def server() -> Iterator[Server]:
    """Makes listening sockets on loopback, with a time limit."""
    made: list[socket.socket] = []

    def make(port: int = 0) -> socket.socket:
        sock = socket.create_server(("127.0.0.1", port))
        made.append(sock)
        sock.settimeout(PATIENCE_S)
        return sock

    yield make
    for sock in made:
        sock.close()


def port_of(sock: socket.socket) -> int:
    return int(sock.getsockname()[1])


def accept(sock: socket.socket) -> socket.socket:
    peer, _ = sock.accept()
    peer.settimeout(PATIENCE_S)
    return peer


def receive(sock: socket.socket, count: int) -> bytes:
    data = b""
    while len(data) < count:
        more = sock.recv(65536)
        assert more, f"ended after {len(data)} of {count} bytes"
        data += more
    return data


def test_tcp_both_ways(watch: Watch, server: Server) -> None:
    listener = server()
    watched = watch(f"tcp:127.0.0.1:{port_of(listener)}")
    with closing(accept(listener)) as vehicle:
        watched.expect_state(LinkState.UP, f"connected to 127.0.0.1:{port_of(listener)}")
        vehicle.sendall(b"hello")
        watched.expect_data(b"hello")
        assert watched.link.send(b"answer") is True
        assert receive(vehicle, 6) == b"answer"
    counters = watched.link.counters
    assert (counters.rx_bytes, counters.tx_bytes, counters.tx_dropped, counters.opens) == (5, 6, 0, 1)


def test_tcp_comes_up_when_the_server_does_and_again_after_it_went(watch: Watch, server: Server) -> None:
    first = server()
    port = port_of(first)
    first.close()
    watched = watch(f"tcp:127.0.0.1:{port}")
    after = watched.expect_state(LinkState.DOWN, f"cannot connect to 127.0.0.1 port {port}: Connection refused")
    assert watched.link.send(b"x") is False
    for round_ in range(2):
        with closing(server(port)) as listener, closing(accept(listener)) as vehicle:
            after = watched.expect_state(LinkState.UP, after=after)
            vehicle.sendall(b"%d" % round_)
            watched.expect_data(b"01"[: round_ + 1])
        after = watched.expect_state(LinkState.DOWN, "closed the connection", after)
    assert watched.link.counters.opens == 2
    assert watched.link.counters.last_error is not None


def test_tcp_reset_by_the_peer_is_reconnected(watch: Watch, server: Server) -> None:
    listener = server()
    watched = watch(f"tcp:127.0.0.1:{port_of(listener)}")
    vehicle = accept(listener)
    after = watched.expect_state(LinkState.UP)
    vehicle.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")  # close() sends a reset
    vehicle.close()
    after = watched.expect_state(LinkState.DOWN, "reset", after)
    accept(listener).close()
    watched.expect_state(LinkState.UP, after=after)


def test_a_peer_that_never_reads_gets_whole_frames_or_none(watch: Watch, server: Server, frames: Frames) -> None:
    listener = server()
    watched = watch(f"tcp:127.0.0.1:{port_of(listener)}")
    vehicle = accept(listener)
    watched.expect_state(LinkState.UP)
    link = watched.link
    with closing(vehicle):
        accepted, refused = [], 0
        series = frames(256) * 4000  # tens of megabytes: more than the buffers of both ends
        for frame in series:
            if link.send(frame):
                accepted.append(frame)
            else:
                refused += 1
                if refused == 100:
                    break
        assert refused == 100
        assert link.counters.tx_dropped == 100
        assert link.counters.last_error == "the other end does not read: the output buffer is full"
        assert link.counters.tx_bytes == sum(map(len, accepted))
        # Now it reads after all: every accepted frame comes whole, in order, and nothing else.
        stream = b"".join(accepted)
        assert receive(vehicle, len(stream)) == stream
        assert link.send(b"and on") is True
        assert receive(vehicle, 6) == b"and on"
        vehicle.sendall(b"alive")
        watched.expect_data(b"alive")


def test_half_a_frame_is_not_continued_on_the_next_connection(watch: Watch, server: Server, frames: Frames) -> None:
    listener = server()
    watched = watch(f"tcp:127.0.0.1:{port_of(listener)}")
    vehicle = accept(listener)
    after = watched.expect_state(LinkState.UP)
    frame = max(frames(40), key=len)
    while watched.link.send(frame):
        pass
    vehicle.close()
    after = watched.expect_state(LinkState.DOWN, after=after)
    with closing(accept(listener)) as vehicle:
        watched.expect_state(LinkState.UP, after=after)
        assert watched.link.send(b"first") is True
        assert receive(vehicle, 5) == b"first"


def test_tcp_burst_both_ways(watch: Watch, server: Server, frames: Frames) -> None:
    listener = server()
    watched = watch(f"tcp:127.0.0.1:{port_of(listener)}")
    stream = b"".join(frames(256)) * 100
    with closing(accept(listener)) as vehicle:
        watched.expect_state(LinkState.UP)
        sender = threading.Thread(target=vehicle.sendall, args=(stream,))
        sender.start()
        watched.expect_data(stream)
        sender.join()
        for frame in frames(256):
            assert watched.link.send(frame) is True
        assert receive(vehicle, len(b"".join(frames(256)))) == b"".join(frames(256))


def test_close_ends_a_connect_that_hangs(server: Server) -> None:
    """A listener whose queue is full does not answer; close() must not wait for the connect to time out."""
    listener = socket.socket()
    listener.bind(("127.0.0.1", 0))
    listener.listen(0)
    blockers = []
    with closing(listener):
        while True:  # fill the queue
            blocker = socket.socket()
            blockers.append(blocker)
            blocker.setblocking(False)
            blocker.connect_ex(listener.getsockname())
            if not select.select([], [blocker], [], 0.5)[1]:
                break
        link = open_link(f"tcp:127.0.0.1:{port_of(listener)}")
        opening = threading.Event()
        link.start(lambda data: None, lambda state, detail: opening.set())
        assert opening.wait(PATIENCE_S)
        assert not link.wait(LinkState.UP, 0.2)
        link.close()
        assert link.state is LinkState.CLOSED
        for blocker in blockers:
            blocker.close()


def test_options_of_a_stream() -> None:
    with closing(socket.socket()) as sock:
        tcp.set_stream_options(sock)
        assert sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY) == 1
        assert sock.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE) == 1
        assert sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE) == tcp.KEEPALIVE_IDLE_S
        assert sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) == tcp.DEAD_PEER_S * 1000


SELF_CONNECT = """
import socket, subprocess, threading
from pathlib import Path
from zmav.links import LinkState, open_link
subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
Path("/proc/sys/net/ipv4/ip_local_port_range").write_text("40000 40001")
with socket.socket() as plain:  # the kernel does it, when it is let
    while plain.connect_ex(("127.0.0.1", 40000)):
        pass
    assert plain.getsockname() == plain.getpeername()
    plain.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, bytes([1, 0, 0, 0, 0, 0, 0, 0]))
link = open_link("tcp:127.0.0.1:40000")
states, enough = [], threading.Event()
def on_state(state, detail):
    states.append((state, detail))
    if "nobody listens there" in detail:
        enough.set()
link.start(lambda data: None, on_state)
assert enough.wait(60), states
link.close()
assert not [state for state, _ in states if state is LinkState.UP], states
"""


@pytest.mark.root
def test_tcp_does_not_connect_to_itself(root: Path) -> None:
    """A port nobody listens on, among those the kernel chooses from, can be connected to itself: that is no peer."""
    try:
        subprocess.run(["unshare", "-n", "ip", "link"], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        pytest.skip("no network namespaces here")
    done = subprocess.run(
        ["unshare", "-n", sys.executable, "-c", SELF_CONNECT], cwd=root, capture_output=True, text=True, timeout=100
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.root
def test_a_peer_that_vanished_is_found_by_keepalive(
    watch: Watch, server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    """TCP_REPAIR lets a socket end without a word to the other side, as a machine does that loses its power."""
    monkeypatch.setattr(tcp, "KEEPALIVE_IDLE_S", 1)
    listener = server()
    watched = watch(f"tcp:127.0.0.1:{port_of(listener)}")
    vehicle = accept(listener)
    after = watched.expect_state(LinkState.UP)
    try:
        vehicle.setsockopt(socket.IPPROTO_TCP, 19, 1)  # TCP_REPAIR
    except OSError:
        vehicle.close()
        pytest.skip("TCP_REPAIR is not permitted here")
    vehicle.close()
    watched.expect_state(LinkState.DOWN, "", after)
