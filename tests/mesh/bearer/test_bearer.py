"""A bearer over real sockets: what it carries, what it keeps, and what it does not take from strangers."""

from __future__ import annotations

import os
import random
import socket
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import zenoh

from mesh.bearer.bearer import Bearer
from mesh.bearer.header import host_tag, pack_data, pack_probe
from mesh.bearer.peer import LEARNED, Health
from mesh.bearer.port import RadioPort
from tests.mesh.bearer.conftest import FLEET, Pair, udp
from tests.ports import free_udp_ports
from tests.waiting import wait_until
from zmav.config import Radio
from zmav.session import SessionSettings, open_session

LEFT, RIGHT = 0, 1
MakePair = Callable[..., Pair]


def reached(bearer: Bearer, name: str) -> bool:
    routes = bearer.status.get(name, ())
    return any(route.in_use and route.health is Health.CARRIES for route in routes)


def linked(pair: Pair) -> tuple[Bearer, Bearer]:
    left, right = pair.start(LEFT), pair.start(RIGHT)
    wait_until(lambda: reached(left, "right") and reached(right, "left"), "path")
    return left, right


@pytest.fixture
def router() -> Iterator[Callable[..., zenoh.Session]]:
    opened: list[zenoh.Session] = []

    def router(pair: Pair, side: int, bearer: Bearer) -> zenoh.Session:
        def ends(port: int) -> str:
            return f"udp/127.0.0.1:{port}?rel=1;mixed_rel=1"

        connect = [ends(port) for _, port in bearer.local.values()]
        # A busy machine may hold everything up for a second: that must not end the link.
        cfg = ["scouting/delay:0", "transport/link/tx/lease:5000"]
        how = SessionSettings(mode="router", listen=[ends(pair.routers[side])], connect=connect, cfg=cfg)
        opened.append(open_session(how))
        return opened[-1]

    yield router
    for each in opened:
        each.close()


class Echoes:
    """A router's place taken by a plain socket, which says back what it hears."""

    def __init__(self, port: int) -> None:
        self.socket = udp(port)
        self.socket.settimeout(30.0)

    def hear(self) -> tuple[bytes, tuple[str, int]]:
        data, source = self.socket.recvfrom(65536)
        return data, source


def test_datagrams_go_there_and_back_unchanged_each_on_its_own_flow(pair: MakePair) -> None:
    both = pair(None)
    left, _ = linked(both)
    there = Echoes(both.routers[RIGHT])
    first, second = udp(), udp()
    for each in (first, second):
        each.settimeout(30.0)
        each.connect(left.local["right"])
    sources = []
    for each, word in ((first, os.urandom(1452)), (second, b"x"), (first, os.urandom(1200))):
        each.send(word)
        data, source = there.hear()
        assert data == word
        sources.append(source)
        there.socket.sendto(word[::-1], source)
        assert each.recv(65536) == word[::-1]
    assert sources[0] == sources[2] != sources[1]
    for each in (first, second, there.socket):
        each.close()


def test_a_session_lives_on_when_its_radio_dies_and_nothing_is_lost(
    pair: MakePair, router: Callable[..., zenoh.Session]
) -> None:
    both = pair(None, None)
    left, right = linked(both)
    far = router(both, RIGHT, right)
    near = router(both, LEFT, left)
    heard: list[int] = []
    far.declare_subscriber("t/n", lambda sample: heard.append(int(sample.payload.to_bytes())))
    publisher = near.declare_publisher("t/n", congestion_control=zenoh.CongestionControl.BLOCK)
    wait_until(lambda: bool(publisher.matching_status.matching), "subscriber")  # type: ignore[attr-defined]
    while not heard:  # that it matches is known before the first word has a way
        publisher.put("-1")
        time.sleep(0.02)
    for n in range(50):
        if n == 20:
            both.airs[0].cut = True
        publisher.put(str(n))
        time.sleep(0.01)
    wait_until(lambda: heard[-1] == 49, "last word")
    assert [n for n in heard if n >= 0] == list(range(50))
    routes = {route.in_use: route for route in left.status["right"]}
    assert routes[True].address.endswith(str(both.airs[1].end(LEFT)[1]))
    assert [str(zid) for zid in near.info.routers_zid()] == [str(far.info.zid())]


def test_a_neighbour_that_restarts_is_linked_again(pair: MakePair, router: Callable[..., zenoh.Session]) -> None:
    both = pair(None)
    left, right = linked(both)
    first = router(both, RIGHT, right)
    near = router(both, LEFT, left)
    wait_until(lambda: str(first.info.zid()) in [str(zid) for zid in near.info.routers_zid()], "link")
    first.close()
    both.stop(right)
    wait_until(lambda: not list(near.info.routers_zid()), "end of the link")
    both.routers[RIGHT] = free_udp_ports(1)  # Zenoh lets go of the old one some time after the close
    right = both.start(RIGHT)
    second = router(both, RIGHT, right)
    wait_until(lambda: str(second.info.zid()) in [str(zid) for zid in near.info.routers_zid()], "new link")


def test_garbage_and_strangers_get_nothing_and_what_is_carried_goes_on(pair: MakePair) -> None:
    both = pair(None)
    left, right = linked(both)
    stranger, there = udp(), Echoes(both.routers[RIGHT])
    port = ("127.0.0.1", both.ports[RIGHT][0])
    tag, noise = host_tag(FLEET, "left"), random.Random(5)
    junk = [
        b"",
        b"\xb1",
        b"\xb3" + bytes(3),
        bytes(2000),
        pack_data(1, 1, False, b"not of the fleet"),
        pack_data(tag, 1, False, b"from an address that has proven nothing"),
        pack_data(tag, 1, True, b"an answer to a flow that is none"),
        pack_probe(7, 1, 1, echo=False),
        pack_probe(tag, 99, 1, echo=True),
        *(noise.randbytes(noise.randrange(1, 100)) for _ in range(500)),
    ]
    for data in junk:
        stranger.sendto(data, port)
    mine = udp()
    mine.settimeout(30.0)
    mine.connect(left.local["right"])
    mine.send(b"still there")
    assert there.hear()[0] == b"still there"
    wait_until(lambda: right.ports[0].counters.foreign >= len(junk), "refusal of each")
    stranger.setblocking(False)
    with pytest.raises(BlockingIOError):
        stranger.recv(100)
    for each in (stranger, mine, there.socket):
        each.close()


def test_who_asks_gets_no_more_bytes_than_he_sent(pair: MakePair) -> None:
    """A thousand probes in a neighbour's name, from an address that never echoes: bounded answers, and no data."""
    both = pair(None)
    linked(both)
    stranger = udp()
    probe = pack_probe(host_tag(FLEET, "left"), 1, 1, echo=False)
    for _ in range(1000):
        stranger.sendto(probe, ("127.0.0.1", both.ports[RIGHT][0]))
    stranger.settimeout(1.0)
    got = 0
    with pytest.raises(TimeoutError):
        while True:
            got += len(stranger.recv(2048))
            assert got < 1000 * len(probe) / 4
    assert got > 0
    stranger.close()


def test_a_neighbour_behind_another_address_is_learned_once_it_has_echoed(pair: MakePair) -> None:
    """Its air's port changes, as behind a NAT: the old address is silent, the new one proves itself and is taken.

    Others who call in its name from elsewhere, and never echo, take up no room that it needs.
    """
    both = pair(None)
    _, right = linked(both)
    moved = udp()
    moved.settimeout(30.0)
    both.airs[0].cut = True
    tag, there = host_tag(FLEET, "left"), ("127.0.0.1", both.ports[RIGHT][0])
    liars = [udp() for _ in range(LEARNED)]
    for each in liars:
        each.sendto(pack_probe(tag, 5, 1, echo=False), there)
        each.recv(2048)
    moved.sendto(pack_probe(tag, 5, 1, echo=False), there)
    name = f"127.0.0.1:{moved.getsockname()[1]}"
    while name not in [route.address for route in right.status["left"]]:
        data = moved.recv(2048)
        if data[0] == 0xB3:  # it wants to know whether we are really here
            moved.sendto(bytes([0xB4]) + tag.to_bytes(4, "big") + data[5:], there)
        moved.sendto(pack_probe(tag, 5, 1, echo=False), there)
    for each in (moved, *liars):
        each.close()


def test_a_budget_is_kept_in_every_second_with_two_neighbours_flooding_it(pair: MakePair) -> None:
    both = pair("60 kB/s")
    left, _ = linked(both)
    air, there = both.airs[0], Echoes(both.routers[RIGHT])
    floods = [udp() for _ in range(2)]
    end, flooded = time.monotonic() + 2.5, 0
    while time.monotonic() < end:
        for flood in floods:
            flood.sendto(bytes(1200), left.local["right"])
        flooded += len(floods)
        time.sleep(0.002)
    for each in (*floods, there.socket):
        each.close()
    sent = [(at, size) for at, way, size in air.carried if way == LEFT]
    for start, _ in sent:
        assert sum(size for at, size in sent if start <= at < start + 1.0) <= 1.05 * 60e3
    last = max(at for at, _ in sent)
    # On a loaded machine what was late is not made up for, so the lower bound is a loose one.
    assert sum(size for at, size in sent if at > last - 2.0) > 0.7 * 2.0 * 60e3
    assert left.ports[0].counters.dropped > 0.2 * flooded  # of 2,500 where the machine keeps up


def test_a_radio_that_comes_later_is_used_then(pair: MakePair) -> None:
    both = pair(None, None)
    taken = udp(both.ports[LEFT][0])
    left, right = both.start(LEFT), both.start(RIGHT)
    wait_until(lambda: reached(left, "right"), "path through the other radio")
    assert left.ports[0].socket is None
    taken.close()
    wait_until(lambda: left.ports[0].socket is not None, "first radio")
    wait_until(lambda: all(r.health is Health.CARRIES for r in left.status["right"]), "both paths")
    assert right.ports[0].socket is not None


def test_what_is_larger_than_any_of_the_radios_carries_is_dropped_and_counted(pair: MakePair) -> None:
    """QUIC then keeps to what crosses all of them, and a change of paths is no black hole to it."""
    both = pair(None, None)
    left, _ = linked(both)
    mine = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    mine.sendto(bytes(65_507), left.local["right"])  # loopback carries 65,507; with our header it is more
    counted, there = left.ports[0].counters, Echoes(both.routers[RIGHT])
    wait_until(lambda: counted.too_big == 1, "count")
    left.ports[1].largest = 1300
    wait_until(lambda: mine.sendto(bytes(1294), left.local["right"]) > 0 and counted.too_big > 1, "count")
    mine.sendto(bytes(1293), left.local["right"])
    while len(there.hear()[0]) != 1293:
        pass  # what was still let through
    mine.close()
    there.socket.close()


def test_a_port_that_another_program_holds_is_said_once(caplog: pytest.LogCaptureFixture) -> None:
    """Or nothing would say why no link comes: the router itself listens on another port."""
    taken = udp()
    number = taken.getsockname()[1]
    port = RadioPort(Radio(address="127.0.0.1"), number, 0.0)
    assert not any(port.open(10.0 * look) for look in range(3))
    (line,) = [record.getMessage() for record in caplog.records]
    assert f"port {number} is in use by another program" in line
    taken.close()
    assert port.open(100.0)
    port.close()
    again = udp(number)
    assert not port.open(200.0)
    assert [record.getMessage() for record in caplog.records] == [line, line], "of another program, too"
    again.close()


@pytest.mark.skipif(sys.platform != "linux", reason="asks Linux")
def test_a_radio_s_interface_tells_how_much_it_carries() -> None:
    port = RadioPort(Radio(address="127.0.0.1", interface="lo"), free_udp_ports(1), 0.0)
    assert port.open(0.0)
    assert port.largest == int(Path("/sys/class/net/lo/mtu").read_text()) - 28
    port.close()
