"""Link URLs: every accepted spelling means one canonical form; everything else is refused with what was expected."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zmav.errors import BadUrl
from zmav.links import (
    LinkState,
    LinkUrl,
    ReplayLink,
    ReplayUrl,
    SerialLink,
    SerialUrl,
    SocketUrl,
    TcpLink,
    UdpInLink,
    UdpOutLink,
    open_link,
    parse_url,
)

BY_PATH = "/dev/serial/by-path/pci-0000:00:14.0-usb-0:1:1.0-port0"

SERIAL: list[tuple[str, LinkUrl]] = [
    ("serial:/dev/ttyACM0:57600", SerialUrl("/dev/ttyACM0", 57600)),
    ("serial:/dev/ttyACM0", SerialUrl("/dev/ttyACM0")),
    ("/dev/ttyACM0", SerialUrl("/dev/ttyACM0")),
    ("/dev/ttyUSB0,57600", SerialUrl("/dev/ttyUSB0", 57600)),
    ("/dev/ttyUSB0:921600", SerialUrl("/dev/ttyUSB0", 921600)),
    ("  /dev/ttyUSB0  ", SerialUrl("/dev/ttyUSB0")),
    ("serial:/dev/ttyUSB0?baud=57600", SerialUrl("/dev/ttyUSB0", 57600)),
    ("serial:/dev/ttyUSB0?baud=auto", SerialUrl("/dev/ttyUSB0")),
    ("/dev/ttyS1:57600?rtscts=1", SerialUrl("/dev/ttyS1", 57600, rtscts=True)),
    ("serial:///dev/ttyUSB0:57600", SerialUrl("/dev/ttyUSB0", 57600)),
    (BY_PATH, SerialUrl(BY_PATH)),
    (f"{BY_PATH},57600", SerialUrl(BY_PATH, 57600)),
    ("serial:/tmp/odd:12?baud=auto", SerialUrl("/tmp/odd:12")),
    (
        "/dev/serial/by-id/usb-ArduPilot_CubeOrange+_42-if00",
        SerialUrl("/dev/serial/by-id/usb-ArduPilot_CubeOrange+_42-if00"),
    ),
]
SOCKET: list[tuple[str, LinkUrl]] = [
    ("udpin:127.0.0.1:14550", SocketUrl("udpin", "127.0.0.1", 14550)),
    ("udpin:0.0.0.0:14550", SocketUrl("udpin", "0.0.0.0", 14550)),
    ("udpin::14550", SocketUrl("udpin", "127.0.0.1", 14550)),
    ("udpin:127.0.0.1:0", SocketUrl("udpin", "127.0.0.1", 0)),
    ("UDPIN:127.0.0.1:14550", SocketUrl("udpin", "127.0.0.1", 14550)),
    ("udp:127.0.0.1:14550", SocketUrl("udpin", "127.0.0.1", 14550)),
    ("127.0.0.1:14550", SocketUrl("udpin", "127.0.0.1", 14550)),
    ("localhost:14550", SocketUrl("udpin", "localhost", 14550)),
    ("[::1]:14550", SocketUrl("udpin", "::1", 14550)),
    ("udpin:[fe80::1%eth0]:14550", SocketUrl("udpin", "fe80::1%eth0", 14550)),
    ("udp://:14540", SocketUrl("udpin", "127.0.0.1", 14540)),
    ("udp://0.0.0.0:14540", SocketUrl("udpin", "0.0.0.0", 14540)),
    ("udp://[::]:14540", SocketUrl("udpin", "::", 14540)),
    ("udp://10.0.0.7:14540", SocketUrl("udpout", "10.0.0.7", 14540)),
    ("udpin://0.0.0.0:14540", SocketUrl("udpin", "0.0.0.0", 14540)),
    ("udpout://quad1.local:14550", SocketUrl("udpout", "quad1.local", 14550)),
    ("udpout:quad_1:14550", SocketUrl("udpout", "quad_1", 14550)),
    ("udpout:127.0.0.1:14580?local=14540", SocketUrl("udpout", "127.0.0.1", 14580, 14540)),
    ("tcp:127.0.0.1:5760", SocketUrl("tcp", "127.0.0.1", 5760)),
    ("tcp::5760", SocketUrl("tcp", "127.0.0.1", 5760)),
    ("tcp://10.0.0.7:5760", SocketUrl("tcp", "10.0.0.7", 5760)),
    ("tcpout://10.0.0.7:5760", SocketUrl("tcp", "10.0.0.7", 5760)),
]

BAD = [
    ("", "url", ""),
    ("   ", "url", ""),
    ("14550", "url", "udpin:127.0.0.1:14550"),
    ("mavlink", "url", ""),
    ("ttyACM0", "path", "/dev/ttyACM0"),
    ("serial:ttyUSB0:57600", "path", "serial:/dev/ttyUSB0:57600"),
    ("serial:", "path", ""),
    ("/dev/ttyUSB0,", "baud", ""),
    ("/dev/ttyUSB0,fast", "baud", ""),
    ("/dev/ttyUSB0:12", "baud", ""),
    ("/dev/ttyUSB0?baud=-57600", "baud", ""),
    ("/dev/ttyUSB0?baud=99999999999", "baud", ""),
    ("/dev/ttyUSB0?rtscts=maybe", "rtscts", ""),
    ("/dev/ttyUSB0?bauds=57600", "option", "baud"),
    ("/dev/ttyUSB0?baud=57600&baud=9600", "options", ""),
    ("udpn:127.0.0.1:14550", "scheme", "udpin:127.0.0.1:14550"),
    ("udpn:14550", "scheme", "udpin:127.0.0.1:14550"),
    ("http://example.org:80", "scheme", ""),
    ("udpin:14550", "port", "udpin:127.0.0.1:14550"),
    ("udpin:127.0.0.1", "port", ""),
    ("udpin:[::1]", "port", ""),
    ("udpin:127.0.0.1:", "port", ""),
    ("udpin:127.0.0.1:65536", "port", ""),
    ("udpin:127.0.0.1:-1", "port", ""),
    ("udpin:127.0.0.1:１４５５０", "port", ""),  # noqa: RUF001 - digits, but not those of a port
    ("tcp:127.0.0.1:0", "port", ""),
    ("udpout:127.0.0.1:0", "port", ""),
    ("udpin:*:14550", "host", "udpin:0.0.0.0:14550"),
    ("udpin:::1:14550", "host", "udpin:[::1]:14550"),
    ("udpin:[127.0.0.1]:14550", "host", ""),
    ("udpin:300.1.1.1:14550", "host", ""),
    ("udpin:two words:14550", "host", ""),
    ("udpout:0.0.0.0:14550", "host", "udpout:127.0.0.1:14550"),
    ("tcp://:5760", "host", "tcp:127.0.0.1:5760"),
    ("udpout:127.0.0.1:14550?local=x", "local", ""),
    ("udpin:127.0.0.1:14550?local=14551", "option", ""),
    ("replay:", "file", ""),
    ("replay:/nowhere/flight.tlog", "file", ""),
    ("/nowhere/flight.tlog", "file", ""),
    ("replay:~nobody-of-that-name/flight.tlog", "file", ""),
    ("replay:/" + "x" * 5000, "file", ""),
]


@pytest.mark.parametrize(("text", "meaning"), SERIAL + SOCKET)
def test_spelling_has_one_meaning_and_one_canonical_form(text: str, meaning: LinkUrl) -> None:
    assert parse_url(text) == meaning
    assert parse_url(str(meaning)) == meaning
    assert open_link(text).url == str(meaning)


@pytest.mark.parametrize(("text", "field", "hint"), BAD)
def test_bad_url_names_field_value_and_what_was_expected(text: str, field: str, hint: str) -> None:
    with pytest.raises(BadUrl) as caught:
        open_link(text)
    detail = caught.value.detail
    assert detail["field"] == field
    assert detail.get("hint", "") == hint
    assert detail["expected"]
    assert repr(detail["value"]) in str(caught.value)
    assert detail["expected"] in str(caught.value)
    assert hint in str(caught.value)
    if hint.startswith(("udp", "/dev", "serial")):
        parse_url(hint)  # a hint must itself be right


def test_recordings(tmp_path: Path) -> None:
    file = tmp_path / "flight.tlog"
    file.write_bytes(b"")
    for text, meaning in [
        (f"{file}", ReplayUrl(str(file))),
        (f"replay:{file}", ReplayUrl(str(file))),
        (f"replay://{file}?speed=4", ReplayUrl(str(file), 4.0)),
        (f"replay:{file}?speed=0.5x", ReplayUrl(str(file), 0.5)),
        (f"{file}?speed=max", ReplayUrl(str(file), 0.0)),
    ]:
        assert parse_url(text) == meaning
        assert parse_url(str(meaning)) == meaning
    for speed in ("-1", "nan", "inf", "fast", ""):
        with pytest.raises(BadUrl) as caught:
            parse_url(f"{file}?speed={speed}")
        assert caught.value.detail["field"] == "speed"
    with pytest.raises(BadUrl):
        parse_url(f"replay:{tmp_path}")


def test_each_scheme_has_its_link(tmp_path: Path) -> None:
    file = tmp_path / "a.tlog"
    file.write_bytes(b"")
    kinds = {
        "/dev/ttyACM0": SerialLink,
        "udpin::14550": UdpInLink,
        "udpout::14550": UdpOutLink,
        "tcp::5760": TcpLink,
        str(file): ReplayLink,
    }
    for url, kind in kinds.items():
        link = open_link(url)
        assert type(link) is kind
        assert link.state is LinkState.CLOSED
        link.close()


@given(st.text(max_size=60) | st.from_regex(r"(udp|tcp|serial|replay)[a-z]{0,4}:(//)?[\w.:\[\]?=&/,~-]{0,40}"))
def test_any_text_is_a_url_or_a_bad_url(text: str) -> None:
    try:
        meaning = parse_url(text)
    except BadUrl as error:
        assert error.detail["field"]
    else:
        assert parse_url(str(meaning)) == meaning
