"""Which endpoints reach beyond this computer, and what is said of them."""

from __future__ import annotations

import pytest

from mesh.credentials.exposure import check_exposed, is_exposed
from zmav.errors import BadConfig

HERE = (
    "tcp/127.0.0.1:7447",
    "tcp/127.9.9.9:1",
    "udp/127.0.0.1:7447?rel=1;mixed_rel=1",
    "tcp/[::1]:7447",
    "tcp/[::ffff:127.0.0.1]:7447",
    "tcp/localhost:7447#iface=lo",
    "unixsock-stream//run/zmav.sock",
)
THERE = (
    "tcp/0.0.0.0:7447",
    "tcp/[::]:7447",
    "udp/10.77.0.1:7447?rel=1;mixed_rel=1",
    "tcp/[fe80::1%eth0]:7447",
    "tcp/no-such-host.invalid:7447",
    "udp/224.0.0.224:7446",
    "serial//dev/ttyUSB0#baudrate=57600",
    "ws/10.0.0.1:80",
    "tcp/",
    "",
)


@pytest.mark.parametrize("endpoint", HERE)
def test_loopback_needs_nothing(endpoint: str) -> None:
    assert not is_exposed(endpoint)
    check_exposed([endpoint], None, insecure=False)
    check_exposed([endpoint], object(), insecure=False)


@pytest.mark.parametrize("endpoint", THERE)
def test_everything_else_needs_credentials_and_a_protocol_that_asks_for_them(endpoint: str) -> None:
    assert is_exposed(endpoint)
    for credentials in (None, object()):
        with pytest.raises(BadConfig, match="--insecure") as e:
            check_exposed(["tcp/127.0.0.1:7447", endpoint], credentials, insecure=False)
        assert e.value.detail["value"] == endpoint
    check_exposed([endpoint], None, insecure=True)


@pytest.mark.parametrize("protocol", ["tls", "quic"])
def test_what_asks_for_certificates_is_open_to_members_only(protocol: str) -> None:
    endpoint = f"{protocol}/10.77.0.1:7447?mixed_rel=1"
    check_exposed([endpoint], object(), insecure=False)
    with pytest.raises(BadConfig, match="there are no credentials"):
        check_exposed([endpoint], None, insecure=False)


def test_scouting_speaks_to_whoever_hears_it() -> None:
    with pytest.raises(BadConfig, match="multicast scouting"):
        check_exposed([], None, insecure=False, scouting=True)
    check_exposed([], None, insecure=True, scouting=True)
    check_exposed([], object(), insecure=False, scouting=True)
