"""What is read from the kernel, and what a kernel without it, or with nonsense in it, leads to."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mesh.quality import interface
from mesh.quality.interface import address_of, interface_to, signal

WIRELESS = """Inter-| sta-|   Quality        |   Discarded packets               | Missed | WE
 face | tus | link level noise |  nwid  crypt   frag  retry   misc | beacon | 22
 wlan0: 0000   70.  -40.  -256        0      0      0      0      0        0
 wlan1: 0000   70.   60.  -256        0      0      0      0      0        0
 wlan2: 0000
"""
ARP = """IP address       HW type     Flags       HW address            Mask     Device
10.77.0.2        0x1         0x2         02:00:00:00:00:02     *        wlan0
10.77.0.3        0x1         0x0         00:00:00:00:00:00     *        wlan0
10.77.0.4        0x1         0x2         zz:00:00:00:00:02     *        wlan0
"""


@pytest.fixture
def proc(tmp_path: Path) -> Path:
    for name, text in (("wireless", WIRELESS), ("arp", ARP)):
        (tmp_path / name).write_text(text)
    return tmp_path


def test_a_radios_signal_is_that_of_its_access_point(proc: Path) -> None:
    assert signal("wlan0", "10.77.0.99", proc) == -40.0
    assert signal("wlan1", "10.77.0.99", proc) is None  # no dBm
    assert signal("wlan2", "10.77.0.99", proc) is None
    assert signal("eth0", "10.77.0.99", proc) is None


def test_a_stations_own_signal_goes_first(proc: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, bytes]] = []

    def answer(name: str, mac: bytes) -> float:
        asked.append((name, mac))
        return -71.0

    monkeypatch.setattr(interface, "station_signal", answer)
    assert signal("wlan0", "10.77.0.2", proc) == -71.0
    assert asked == [("wlan0", b"\x02\0\0\0\0\x02")]
    for address in ("10.77.0.3", "10.77.0.4", "10.77.0.5"):
        assert signal("wlan0", address, proc) == -40.0  # no MAC is known


def test_without_the_files_nothing_is_known(tmp_path: Path) -> None:
    assert signal("wlan0", "10.77.0.2", tmp_path) is None


@given(st.binary(max_size=300))
def test_nonsense_in_the_files_is_left_out(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    folder = tmp_path_factory.mktemp("proc")
    for name in ("wireless", "arp"):
        (folder / name).write_bytes(data)
    assert signal("wlan0", "10.77.0.2", folder) is None or data


def test_a_wire_has_no_station() -> None:
    """The real kernel: no such family, or no radio."""
    assert interface.station_signal("lo", b"\x02\0\0\0\0\x02") is None
    assert interface.station_signal("no-such-one", b"\x02\0\0\0\0\x02") is None


def attribute(kind: int, value: bytes) -> bytes:
    return (struct.pack("=HH", 4 + len(value), kind) + value).ljust((len(value) + 7) & ~3, b"\0")


def message(*parts: bytes, kind: int = 30) -> bytes:
    body = b"\1\1\0\0" + b"".join(parts)
    return struct.pack("=IHHII", 16 + len(body), kind, 0, 1, 0) + body


def test_a_stations_answer_is_read() -> None:
    info = attribute(1, b"\0\0\0\0") + attribute(7, b"\xc4")
    said = message(attribute(3, b"\1\0\0\0"), attribute(21 | 0x8000, info + attribute(13, b"\xba")))
    assert interface.level(interface.attributes(said)) == -70.0
    assert interface.level(interface.attributes(message(attribute(21, info)))) == -60.0
    assert interface.level(interface.attributes(message(attribute(21, attribute(7, b"\x10"))))) is None
    assert interface.level(interface.attributes(message(attribute(21, info), kind=2))) is None  # NLMSG_ERROR


@given(st.binary(max_size=200))
def test_any_answer_is_survived(data: bytes) -> None:
    interface.level(interface.attributes(data))
    interface.level(interface.attributes(message(data)))


@pytest.mark.parametrize(
    ("locator", "address"),
    [
        ("udp/10.77.0.2:7447?rel=1;mixed_rel=1", "10.77.0.2"),
        ("quic/[fd00::2]:7447", "fd00::2"),
        ("tcp/[fe80::1%wlan0]:7447", "fe80::1"),
        ("tcp/ground.local:7447", None),
        ("unixsock-stream//tmp/x", None),
        ("", None),
    ],
)
def test_an_address_in_a_locator(locator: str, address: str | None) -> None:
    assert address_of(locator) == address


def test_the_interface_to_a_neighbour() -> None:
    assert interface_to("udp/10.77.0.2:7447", ["wlan0"]) == "wlan0"
    assert interface_to("udp/127.0.0.1:7447", ["lo", "eth0"]) == "lo"
    assert interface_to("udp/nobody:7447", []) is None
