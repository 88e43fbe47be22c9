"""The bad link: whole frames lost and late, in order, the same for the same seed, and never torn."""

from __future__ import annotations

import socket
import threading
import time

from hypothesis import given
from hypothesis import strategies as st

from tests.lossy import Cutter, open_lossy
from zmav.links import LinkState
from zmav.mavlink import Packer, Splitter, load_dialect

PATIENCE_S = 30.0
COUNT = 2000


class Heard:
    """What a link handed over, and when."""

    def __init__(self) -> None:
        self.data: list[bytes] = []
        self.states: list[LinkState] = []
        self.at: list[float] = []
        self._news = threading.Condition()

    def on_data(self, data: bytes) -> None:
        with self._news:
            self.data.append(data)
            self.at.append(time.monotonic())
            self._news.notify_all()

    def on_state(self, state: LinkState, detail: str) -> None:
        with self._news:
            self.states.append(state)
            self._news.notify_all()

    def until(self, last: bytes) -> None:
        with self._news:
            assert self._news.wait_for(lambda: self.data and self.data[-1] == last, PATIENCE_S)


def frames(count: int) -> list[bytes]:
    packer = Packer(load_dialect(), 1, 1)
    return [packer.pack("ATTITUDE", time_boot_ms=n, roll=0.1 * (n % 7)) for n in range(count)]


def carried(url_options: str, sent: list[bytes], chunk: int) -> Heard:
    """What of a TCP stream, written ``chunk`` bytes at a time, comes through the link; ends with a mark never lost."""
    mark = b"\x00end"
    heard = Heard()
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        with open_lossy(f"lossy:tcp:127.0.0.1:{port}?{url_options}") as link:
            link.start(heard.on_data, heard.on_state)
            peer, _ = server.accept()
            with peer:
                data = b"".join(sent)
                for start in range(0, len(data), chunk):
                    peer.sendall(data[start : start + chunk])
                while not (heard.data and heard.data[-1] == mark):  # a mark may be lost, too: then another one comes
                    peer.sendall(mark)
                    with heard._news:
                        heard._news.wait_for(lambda: bool(heard.data) and heard.data[-1] == mark, 0.05)
    return heard


def test_a_share_is_lost_and_nothing_is_torn() -> None:
    sent = frames(COUNT)
    heard = carried("loss=0.2&seed=3", sent, chunk=700)
    came = [data for data in heard.data if data[0] == 0xFD]
    assert set(came) <= set(sent), "a frame came that was not sent"
    assert came == [frame for frame in sent if frame in set(came)], "the order is not kept"
    share = 1 - len(came) / COUNT
    assert 0.16 < share < 0.24  # 4.5 standard deviations of so many throws

    again = carried("loss=0.2&seed=3", sent, chunk=61)
    assert [data for data in again.data if data[0] == 0xFD] == came, "the same seed loses other frames"
    other = carried("loss=0.2&seed=4", sent, chunk=700)
    assert [data for data in other.data if data[0] == 0xFD] != came


def test_late_but_in_order() -> None:
    sent = frames(200)
    start = time.monotonic()
    heard = carried("delay=0.2&jitter=0.1", sent, chunk=4096)
    assert [data for data in heard.data if data[0] == 0xFD] == sent
    assert heard.at[0] - start >= 0.2


def test_what_is_sent_is_lost_and_late_too() -> None:
    sent = frames(COUNT)
    splitter = Splitter(load_dialect())
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.bind(("127.0.0.1", 0))
        peer.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
        peer.settimeout(1.0)
        with open_lossy(f"lossy:udpout:127.0.0.1:{peer.getsockname()[1]}?loss=0.5&seed=1&delay=0.05") as link:
            heard = Heard()
            link.start(heard.on_data, heard.on_state)
            assert link.wait(LinkState.UP, PATIENCE_S)
            start = time.monotonic()
            for frame in sent:
                assert link.send(frame)
            came = [peer.recv(300)]
            assert time.monotonic() - start >= 0.05
            while True:
                try:
                    came.append(peer.recv(300))
                except TimeoutError:
                    break
    numbers = [frame.seq for data in came for frame in splitter.feed(data)]
    assert len(numbers) == len(came)
    assert 0.44 < 1 - len(came) / COUNT < 0.56
    assert came == [frame for frame in sent if frame in set(came)]


def test_what_is_late_is_sent_before_it_closes() -> None:
    """The hold that a companion gives as its last word must not stay in the queue."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.bind(("127.0.0.1", 0))
        peer.settimeout(PATIENCE_S)
        heard = Heard()
        with open_lossy(f"lossy:udpout:127.0.0.1:{peer.getsockname()[1]}?delay=30") as link:
            link.start(heard.on_data, heard.on_state)
            assert link.wait(LinkState.UP, PATIENCE_S)
            assert link.send(b"stop")
        assert peer.recv(100) == b"stop"
        assert heard.states[-1] is LinkState.CLOSED


def test_states_pass_and_a_down_link_takes_nothing() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        heard = Heard()
        with open_lossy(f"lossy:tcp:127.0.0.1:{port}?loss=1&delay=0.01") as link:
            assert not link.send(b"x") and link.counters.tx_dropped == 1
            link.start(heard.on_data, heard.on_state)
            peer, _ = server.accept()
            assert link.wait(LinkState.UP, PATIENCE_S)
            assert link.send(b"lost")
            peer.close()
            with heard._news:
                assert heard._news.wait_for(lambda: LinkState.DOWN in heard.states, PATIENCE_S)
        assert heard.states[:2] == [LinkState.CONNECTING, LinkState.UP]
        assert heard.states[-1] is LinkState.CLOSED
        assert heard.data == []


garbage = st.binary(min_size=1, max_size=5).filter(lambda data: 0xFD not in data and 0xFE not in data)


@given(st.lists(st.sampled_from(frames(5)) | garbage, max_size=12), st.integers(min_value=1, max_value=50))
def test_a_stream_is_cut_as_it_was_joined(pieces: list[bytes], chunk: int) -> None:
    cutter, data = Cutter(), b"".join(pieces)
    cut = [each for start in range(0, len(data), chunk) for each in cutter.cut(data[start : start + chunk])]
    assert b"".join(cut) == data
    whole = [piece for piece in pieces if piece[0] == 0xFD]
    assert [piece for piece in cut if piece[0] == 0xFD] == whole
