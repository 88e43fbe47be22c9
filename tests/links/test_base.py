"""What all links share: starting, closing, callbacks that fail, backoff, and nothing left behind after fifty cycles."""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from zmav.errors import LinkError
from zmav.links import Link, LinkState, SocketUrl, TcpLink, UdpInLink, open_link
from zmav.links.base import Backoff

if TYPE_CHECKING:
    from tests.links.conftest import Watch

PATIENCE_S = 30.0


def ignore(*_: object) -> None:
    """A callback that does nothing."""


def udpin() -> tuple[UdpInLink, Callable[[], tuple[str, int]]]:
    link = open_link("udpin:127.0.0.1:0")
    assert isinstance(link, UdpInLink)

    def address() -> tuple[str, int]:
        assert link.local_address is not None
        return link.local_address[0], link.local_address[1]

    return link, address


def test_backoff_grows_to_three_seconds_and_starts_again() -> None:
    middle = Backoff(chance=lambda: 0.5)
    waits = [middle.next() for _ in range(9)]
    assert waits == pytest.approx([0.2, 0.3, 0.45, 0.675, 1.0125, 1.51875, 2.278125, 3.0, 3.0])
    middle.reset()
    assert middle.next() == pytest.approx(0.2)
    shortest, longest = Backoff(chance=lambda: 0.0), Backoff(chance=lambda: 1.0)
    assert shortest.next() == pytest.approx(0.16)
    assert longest.next() == pytest.approx(0.24)
    assert max(longest.next() for _ in range(20)) == 3.0


def test_started_once_only() -> None:
    link, _ = udpin()
    link.start(ignore, ignore)
    with pytest.raises(LinkError, match="started or closed before"):
        link.start(ignore, ignore)
    link.close()
    with pytest.raises(LinkError, match="started or closed before"):
        link.start(ignore, ignore)


def test_close_is_idempotent_also_when_never_started() -> None:
    link = open_link("tcp:127.0.0.1:9")
    link.close()
    link.close()
    assert link.state is LinkState.CLOSED
    assert link.send(b"x") is False
    assert link.counters.tx_dropped == 1


def test_context_manager_closes() -> None:
    link, _ = udpin()
    with link:
        link.start(ignore, ignore)
        assert link.wait(LinkState.CONNECTING, PATIENCE_S)
    assert link.state is LinkState.CLOSED


def test_wait_ends_early_when_the_link_is_closed() -> None:
    link, _ = udpin()
    link.start(ignore, ignore)
    closer = threading.Timer(0.05, link.close)
    closer.start()
    assert link.wait(LinkState.UP, None) is False  # without an end of its own: only close() can end it
    assert link.wait(LinkState.CLOSED, PATIENCE_S)
    closer.join()


def test_wait_gives_up() -> None:
    link, _ = udpin()
    link.start(ignore, ignore)
    assert link.wait(LinkState.UP, 0.01) is False
    link.close()


def test_callbacks_that_raise_are_survived(caplog: pytest.LogCaptureFixture) -> None:
    link, address = udpin()
    heard: list[bytes] = []
    enough = threading.Event()

    def on_data(data: bytes) -> None:
        heard.append(data)
        if len(heard) == 3:
            enough.set()
        raise RuntimeError("on_data is broken")

    def on_state(state: LinkState, detail: str) -> None:
        if state is LinkState.CONNECTING:
            raise RuntimeError("on_state is broken")

    link.start(on_data, on_state)
    assert link.wait(LinkState.CONNECTING, PATIENCE_S)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        wait_bound(link)
        for number in range(3):
            peer.sendto(bytes([number]), address())
    assert enough.wait(PATIENCE_S)
    link.close()
    assert heard == [b"\x00", b"\x01", b"\x02"]
    assert link.counters.last_error == "on_data failed: RuntimeError: on_data is broken"
    assert [record.message for record in caplog.records if record.levelname == "ERROR"] == [
        "udpin:127.0.0.1:0: on_state failed; the link goes on, and says so only once",
        "udpin:127.0.0.1:0: on_data failed; the link goes on, and says so only once",
    ]
    assert link.counters.rx_bytes == 3


def wait_bound(link: UdpInLink) -> None:
    """The first CONNECTING means "opening"; the one that says "listening" comes once the port is bound."""
    end = time.monotonic() + PATIENCE_S
    while not link.detail.startswith("listening"):
        assert time.monotonic() < end, link.detail
        time.sleep(0.001)


def test_callbacks_may_send_and_close() -> None:
    """Both from the reader thread itself: no deadlock, and the thread ends."""
    link, address = udpin()
    sent: list[bool] = []

    def on_data(data: bytes) -> None:
        sent.append(link.send(b"answer"))
        link.close()

    link.start(on_data, ignore)
    wait_bound(link)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.settimeout(PATIENCE_S)
        peer.sendto(b"question", address())
        assert peer.recv(100) == b"answer"
    assert link.wait(LinkState.CLOSED, PATIENCE_S)
    assert sent == [True]
    for thread in threading.enumerate():
        if thread.name == f"link {link.url}":
            thread.join(PATIENCE_S)
            assert not thread.is_alive()


class CountedTcpLink(TcpLink):
    """A TCP link that lets one wait for its third try."""

    tries = 0

    def _open(self) -> str:
        self.tries += 1
        if self.tries == 4:
            self.tried_thrice.set()
        return super()._open()

    def __init__(self, target: SocketUrl) -> None:
        super().__init__(target)
        self.tried_thrice = threading.Event()


def test_states_are_told_once_each_and_end_with_closed(watch: Watch) -> None:
    link = CountedTcpLink(SocketUrl("tcp", "127.0.0.1", 1))  # nobody listens on port 1
    watched = watch(link)
    assert link.tried_thrice.wait(PATIENCE_S)
    watched.link.close()
    assert [state for state, _ in watched.states] == [LinkState.CONNECTING, LinkState.DOWN, LinkState.CLOSED]
    assert "closed" in repr(watched.link)


def test_backoff_starts_again_only_after_something_was_heard(watch: Watch) -> None:
    resets: list[int] = []

    class Recorded(Backoff):
        def reset(self) -> None:
            resets.append(1)
            super().reset()

    class RecordedLink(TcpLink):
        backoff = Recorded

    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(PATIENCE_S)
        watched = watch(RecordedLink(SocketUrl("tcp", "127.0.0.1", server.getsockname()[1])))
        after = 0
        for word, expected in ((b"", 0), (b"hello", 1), (b"", 1)):
            peer, _ = server.accept()
            peer.sendall(word)
            peer.close()
            after = watched.expect_state(LinkState.DOWN, after=after)
            after = watched.expect_state(LinkState.UP, after=after)  # by then the last end was dealt with
            assert len(resets) == expected


def _make_url(kind: str, tmp_path: Path) -> tuple[str, Callable[[], None]]:
    if kind in ("serial", "serial auto"):
        master, slave = os.openpty()
        name = os.ttyname(slave)

        def close_pty() -> None:
            os.close(master)
            os.close(slave)

        return (f"serial:{name}:57600" if kind == "serial" else f"serial:{name}"), close_pty
    if kind == "replay":
        file = tmp_path / "a.tlog"
        frame = bytes([0xFE, 1, 0, 1, 1, 0, 7, 0, 0])
        file.write_bytes(bytes(8) + frame + (30_000_000).to_bytes(8, "big") + frame)  # the second half a minute later
        return f"replay:{file}", lambda: None
    if kind == "tcp":
        server = socket.create_server(("127.0.0.1", 0), backlog=100)
        return f"tcp:127.0.0.1:{server.getsockname()[1]}", server.close
    return {
        "udpin": "udpin:127.0.0.1:0",
        "udpout": "udpout:127.0.0.1:9",
        "tcp refused": "tcp:127.0.0.1:1",
    }[kind], lambda: None


@pytest.mark.parametrize("kind", ["udpin", "udpout", "tcp", "tcp refused", "serial", "serial auto", "replay"])
def test_many_cycles_leave_no_thread_and_no_descriptor(kind: str, tmp_path: Path) -> None:
    url, clean_up = _make_url(kind, tmp_path)
    descriptors = Path("/proc/self/fd")

    def cycle() -> Link:
        link = open_link(url)
        opened = threading.Event()
        told: list[LinkState] = []

        def on_state(state: LinkState, detail: str) -> None:
            told.append(state)
            if not detail.startswith("opening"):
                opened.set()

        link.start(ignore, on_state)
        assert opened.wait(PATIENCE_S)
        link.close()
        assert link.state is LinkState.CLOSED
        assert told[-1] is LinkState.CLOSED
        return link

    cycle()
    threads, before = threading.active_count(), len(list(descriptors.iterdir()))
    cycles = 15 if kind.startswith("serial") else 50  # the end of a serial line's read takes a tenth of a second
    last = [cycle() for _ in range(cycles)][-1]
    assert threading.active_count() <= threads
    assert len(list(descriptors.iterdir())) <= before
    assert not [thread for thread in threading.enumerate() if thread.name == f"link {last.url}"]
    clean_up()
