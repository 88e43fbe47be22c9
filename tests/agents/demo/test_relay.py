"""The link that a demo cuts: what passes, what does not while it is cut, and who comes and goes."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import pytest

from agents.demo.stage import Relay

PATIENCE_S = 10.0


@pytest.fixture
def server() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as door:
        door.settimeout(PATIENCE_S)
        yield door


@pytest.fixture
def relay(server: socket.socket) -> Iterator[Relay]:
    with Relay(server.getsockname()[1]) as found:
        yield found


def call(relay: Relay) -> socket.socket:
    return socket.create_connection(("127.0.0.1", relay.port), PATIENCE_S)


def test_both_ways_and_the_end_of_one_is_the_end_of_the_other(server: socket.socket, relay: Relay) -> None:
    with call(relay) as near:
        far, _ = server.accept()
        with far:
            far.settimeout(PATIENCE_S)
            near.sendall(b"there")
            assert far.recv(100) == b"there"
            far.sendall(b"back")
            assert near.recv(100) == b"back"
            near.shutdown(socket.SHUT_WR)
            assert far.recv(100) == b""
        assert near.recv(100) == b""


def test_nothing_passes_while_it_is_cut_and_nobody_is_told(server: socket.socket, relay: Relay) -> None:
    with call(relay) as near:
        far, _ = server.accept()
        with far:
            near.sendall(b"before")
            far.settimeout(PATIENCE_S)
            assert far.recv(100) == b"before"
            relay.cut.set()
            near.sendall(b"meanwhile")
            far.settimeout(0.5)
            with pytest.raises(TimeoutError):
                far.recv(100)
            with call(relay):
                server.settimeout(0.3)
                with pytest.raises(TimeoutError):
                    server.accept()
                relay.cut.clear()
                far.settimeout(PATIENCE_S)
                assert far.recv(100) == b"meanwhile"
                server.settimeout(PATIENCE_S)
                server.accept()[0].close()


def test_who_calls_before_the_other_end_is_there_calls_again(server: socket.socket) -> None:
    port = server.getsockname()[1]
    server.close()
    with Relay(port) as relay:
        with call(relay) as near:
            assert near.recv(100) == b""
        with socket.create_server(("127.0.0.1", port)) as late, call(relay) as near:
            late.settimeout(PATIENCE_S)
            far, _ = late.accept()
            with far:
                far.sendall(b"here")
                assert near.recv(100) == b"here"
