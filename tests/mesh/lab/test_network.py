"""Links between real namespaces, probed by real sockets."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import socket
import struct
import subprocess
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from mesh.lab.channel import Counters
from mesh.lab.network import LabError, Network, check_able
from zmav.errors import BadConfig

pytestmark = pytest.mark.root

Make = Callable[..., Network]
PORT = 5000
PATIENCE_S = 10.0
UDP, ETHERNET = 28, 14
"""bytes of IP and UDP headers, and of Ethernet's, that a datagram has around it"""


@pytest.fixture
def sockets(make: Make) -> Iterator[Callable[[Network, str], socket.socket]]:
    """``sockets(network, host)``: a UDP socket in that host, at port 5000 of all its addresses."""
    with contextlib.ExitStack() as stack:

        def open_socket(network: Network, host: str) -> socket.socket:
            with network.inside(host):
                s = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            s.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            s.bind(("", PORT))
            s.settimeout(PATIENCE_S)
            return s

        yield open_socket


def received(s: socket.socket, count: int) -> list[bytes]:
    return [s.recv(65_536) for _ in range(count)]


def drained(s: socket.socket) -> list[bytes]:
    """What lies in the socket now."""
    found = []
    s.setblocking(False)
    with contextlib.suppress(BlockingIOError):
        while True:
            found.append(s.recv(65_536))
    s.settimeout(PATIENCE_S)
    return found


def acquaint(network: Network, *sockets: tuple[str, socket.socket]) -> None:
    """Let each learn all others' MAC addresses, so that what counts below are the test's own frames."""
    for host, s in sockets:
        for other, theirs in sockets:
            if host != other:
                s.sendto(b"hello", (network.address(other), PORT))
                assert theirs.recv(100) == b"hello"


def settled(network: Network, link: str, frames: int) -> Counters:
    """The counters of one direction when it has taken so many frames, and nothing is under way any more."""
    end = time.monotonic() + PATIENCE_S
    while True:
        counters = network.counters(link)[0]
        if counters.frames >= frames and not network.counted().under_way:
            return network.counters(link)[0]
        assert time.monotonic() < end, f"{counters.frames} of {frames} frames"


TWO = {"hosts": {"h1": {}, "h2": {}}, "media": [{"kind": "link", "between": ["h1", "h2"]}]}
THREE: dict[str, Any] = {"hosts": {"h1": {}, "h2": {}, "h3": {}}}


def test_delay_and_both_directions_apart(make: Make, sockets: Callable[..., socket.socket]) -> None:
    network = make(**TWO)
    one, two = sockets(network, "h1"), sockets(network, "h2")
    acquaint(network, ("h1", one), ("h2", two))
    network.set("h1>h2", delay="60 ms")
    for s, to, least in ((one, "h2", 0.06), (two, "h1", 0.0)):
        begun = time.monotonic()
        s.sendto(b"x", (network.address(to), PORT))
        assert (two if s is one else one).recv(10) == b"x"
        assert time.monotonic() - begun >= least
    there, back = network.counters("h1-h2")
    assert (there.lost, back.lost) == (0, 0)
    network.cut("h1>h2")
    one.sendto(b"y", (network.address("h2"), PORT))
    two.sendto(b"z", (network.address("h1"), PORT))
    assert one.recv(10) == b"z"
    assert settled(network, "h1>h2", there.frames + 1).down == 1
    assert drained(two) == []
    network.heal("1-2")
    one.sendto(b"again", (network.address("h2"), PORT))
    assert two.recv(10) == b"again"


def test_loss_is_what_the_counters_say(make: Make, sockets: Callable[..., socket.socket]) -> None:
    network = make(**TWO)
    one, two = sockets(network, "h1"), sockets(network, "h2")
    two.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
    acquaint(network, ("h1", one), ("h2", two))
    network.set("h1>h2", loss="30 %", burst=4)
    before = network.counters("h1>h2")[0]
    for i in range(1000):
        one.sendto(struct.pack("!I", i), (network.address("h2"), PORT))
    settled(network, "h1>h2", before.frames + 1000)
    network.set("h1>h2", loss=0)
    one.sendto(struct.pack("!I", 1000), (network.address("h2"), PORT))
    last, came = -1, []
    while last != 1000:
        (last,) = struct.unpack("!I", two.recv(100))
        came.append(last)
    after = network.counters("h1>h2")[0]
    assert came == sorted(came)
    assert len(came) == after.arrived - before.arrived
    assert after.lost - before.lost == 1001 - len(came)
    assert 0.15 < (after.lost - before.lost) / 1000 < 0.45


def test_a_rate_holds_and_its_queue_drops(make: Make, sockets: Callable[..., socket.socket]) -> None:
    network = make(**TWO)
    one, two = sockets(network, "h1"), sockets(network, "h2")
    acquaint(network, ("h1", one), ("h2", two))
    size = 1000
    frame = size + UDP + ETHERNET
    network.set("h1>h2", rate="2 Mbit/s", queue=20 * frame)
    before = network.counters("h1>h2")[0]
    begun = time.monotonic()
    for _ in range(60):
        one.sendto(bytes(size), (network.address("h2"), PORT))
    after = settled(network, "h1>h2", before.frames + 60)
    seconds = time.monotonic() - begun
    came = len(drained(two))
    assert came == after.arrived - before.arrived
    assert came >= 20
    assert came + after.queue_full - before.queue_full == 60
    assert seconds >= 0.99 * came * frame * 8 / 2e6


def test_frames_up_to_the_mtu_and_no_longer(make: Make, sockets: Callable[..., socket.socket]) -> None:
    network = make(hosts=TWO["hosts"], media=[{"kind": "link", "between": ["h1", "h2"], "mtu": 600}])
    one, two = sockets(network, "h1"), sockets(network, "h2")
    ip_mtu_discover, do = 10, 2
    one.setsockopt(socket.IPPROTO_IP, ip_mtu_discover, do)
    one.sendto(bytes(600 - UDP), (network.address("h2"), PORT))
    assert len(two.recv(2000)) == 600 - UDP
    with pytest.raises(OSError) as caught:
        one.sendto(bytes(601 - UDP), (network.address("h2"), PORT))
    assert caught.value.errno == errno.EMSGSIZE
    one.setsockopt(socket.IPPROTO_IP, ip_mtu_discover, 0)
    one.sendto(bytes(5000), (network.address("h2"), PORT))  # in fragments
    assert len(two.recv(6000)) == 5000


GROUP = "224.0.0.224"


@pytest.mark.parametrize("group", [False, True], ids=["broadcast", "multicast"])
def test_a_radio_reaches_those_in_range_and_no_further(
    make: Make, sockets: Callable[..., socket.socket], group: bool
) -> None:
    media = [{"kind": "radio", "name": "air", "pairs": [["h1", "h2"], ["h2", "h3"]]}]
    network = make(**THREE, media=media)
    found = {host: sockets(network, host) for host in ("h1", "h2", "h3")}
    acquaint(network, ("h1", found["h1"]), ("h2", found["h2"]))
    acquaint(network, ("h2", found["h2"]), ("h3", found["h3"]))
    for host, s in found.items():
        own = socket.inet_aton(network.address(host))
        s.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, own)
        s.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 0)
        s.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(GROUP) + own)
    to = GROUP if group else "10.77.0.255"
    for host, hearers in (("h2", ("h1", "h3")), ("h1", ("h2",))):
        found[host].sendto(host.encode(), (to, PORT))
        drained(found[host])  # a broadcast is heard by its own sender, too
        assert [found[each].recv(10) for each in hearers] == [host.encode()] * len(hearers)
    found["h2"].sendto(b"end", (network.address("h3"), PORT))
    assert found["h3"].recv(10) == b"end"  # and nothing came from h1 before


def test_hosts_do_not_see_each_other_but_through_links(make: Make, sockets: Callable[..., socket.socket]) -> None:
    network = make(**THREE, media=TWO["media"])
    three = sockets(network, "h3")
    with pytest.raises(OSError) as caught:
        three.sendto(b"x", (network.address("h1"), PORT))
    assert caught.value.errno == errno.ENETUNREACH
    three.sendto(b"x", ("127.0.0.1", PORT))  # its own loopback is up
    assert three.recv(10) == b"x"


def test_names_that_are_not_there_are_said_with_those_that_are(make: Make) -> None:
    network = make(**TWO)
    with pytest.raises(BadConfig, match=r"no link '1-9'; expected one of h1-h2"):
        network.cut("1-9")
    with pytest.raises(BadConfig, match=r"no host 'h9' in the lab; it has h1, h2"):
        network.namespace("h9")
    with pytest.raises(BadConfig, match=r"no condition 'los'"):
        network.set("1-2", los=0.1)
    with pytest.raises(BadConfig, match=r"loss is 1.5; expected 0 to 1"):
        network.set("1-2", loss=1.5)
    with pytest.raises(BadConfig, match=r"rate is '5 furlongs'"):
        network.set("1-2", rate="5 furlongs")
    assert network.counted().channels[0].frames == 0  # and it goes on


def test_programs_have_the_hosts_network_and_end_with_it(make: Make) -> None:
    network = make(**TWO)
    script = "echo $$; cat /proc/net/dev; sleep 1000 & exec sleep 1000"
    process = network.popen("h1", ["sh", "-c", script], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert int(process.stdout.readline()) < 1000  # of a PID namespace
    while "wlan0" not in process.stdout.readline():
        pass
    network.close()
    assert process.wait(PATIENCE_S) == -9
    process.stdout.read()  # ends, because the orphan that held it is gone, too
    process.stdout.close()


def test_an_interface_deleted_by_hand_leaves_the_others_alone(
    make: Make, sockets: Callable[..., socket.socket]
) -> None:
    if shutil.which("ip") is None:
        pytest.skip("there is no 'ip' to delete an interface with")
    media = [{"kind": "link", "between": ["h1", "h3"]}, {"kind": "link", "between": ["h1", "h2"]}]
    network = make(**THREE, media=media)
    with network.inside("h3"):
        subprocess.run(["ip", "link", "del", "wlan0"], check=True)
    one, two = sockets(network, "h1"), sockets(network, "h2")
    one.sendto(b"into the void", ("10.77.0.2", PORT))
    one.sendto(b"x", (network.address("h2"), PORT))
    assert two.recv(10) == b"x"
    assert network.counted().channels


def test_forty_hosts_on_one_radio(make: Make, sockets: Callable[..., socket.socket]) -> None:
    names = [f"h{i}" for i in range(40)]
    network = make(hosts={name: {} for name in names}, media=[{"kind": "radio", "name": "air"}])
    first, last = sockets(network, "h0"), sockets(network, "h39")
    first.sendto(b"x", (network.address("h39"), PORT))
    assert last.recv(10) == b"x"
    assert len(network.wiring.edges) == 780


def test_who_is_not_root_is_told_what_is_needed() -> None:
    child = os.fork()
    if child == 0:
        code = 1
        try:
            os.setuid(65_534)
            check_able()
        except LabError as e:
            code = 0 if "needs root and /dev/net/tun; you are user 65534" in str(e) else 2
        finally:
            os._exit(code)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
