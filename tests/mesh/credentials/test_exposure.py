"""Which endpoints reach beyond this computer, and what is said of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from mesh.credentials.ca import Authority
from mesh.credentials.exposure import check_exposed, is_exposed
from mesh.plan import RouterPlan, plan_router
from zmav.errors import BadConfig
from zmav.session import SessionSettings
from zmav.trust.certificate import Role

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


def plan(
    credentials: Path | None = None, *listen: str, file: Path | None = None, cfg: list[str] | None = None
) -> RouterPlan:
    folder, path = str(credentials) if credentials else None, str(file) if file else None
    settings = SessionSettings(mode="router", listen=listen, credentials=folder, file=path, cfg=cfg or ())
    return plan_router(None, "quad1", settings, fleet="alpha")


@pytest.mark.parametrize(
    "cfg",
    [
        ['listen/endpoints:["tcp/0.0.0.0:7447"]'],
        ['listen:{endpoints:["tcp/0.0.0.0:7447"]}'],
        ['/listen/endpoints:["tcp/0.0.0.0:7447"]'],
        ['connect:{endpoints:{router:["tcp/10.9.9.9:7447"]}}'],
        ['listen/endpoints:{peer:["tcp/0.0.0.0:7447"]}', 'mode:"peer"'],
        ["scouting/multicast:{enabled:true}"],
    ],
)
def test_however_it_is_given_to_zenoh_it_does_not_leave_loopback(cfg: list[str]) -> None:
    with pytest.raises(BadConfig, match="would let others in unguarded"):
        plan(cfg=cfg)


def test_a_table_given_whole_is_what_the_plan_says() -> None:
    found = plan(cfg=['listen:{endpoints:["tcp/127.0.0.1:9"]}'])
    assert found.listens == ["tcp/127.0.0.1:9"]
    assert found.settings["listen/endpoints"].source == "--cfg"


def test_beyond_loopback_the_guards_are_those_of_the_credentials(tmp_path: Path) -> None:
    member = Authority.create(tmp_path / "ca", "alpha").issue("quad1", Role.VEHICLE)
    there = "quic/0.0.0.0:7447"
    assert plan(member, there).listens == [there]
    for weaker in (
        "transport/link/tls/enable_mtls:false",
        "transport/link/tls:{enable_mtls:false}",
        'transport/link/tls/root_ca_certificate:"/tmp/other.pem"',
        "access_control/enabled:false",
        'access_control/default_permission:"allow"',
    ):
        with pytest.raises(BadConfig, match="would let others in unguarded"):
            plan(member, there, cfg=[weaker])
        assert plan(member, "tls/127.0.0.1:9", cfg=[weaker]).listens
    with pytest.raises(BadConfig, match="its own guards"):
        plan(member, f"{there}#enable_mtls=false")
    file = tmp_path / "zenoh.json5"
    file.write_text("{transport: {link: {tls: {enable_mtls: false}}}}")
    with pytest.raises(BadConfig, match="transport/link/tls"):
        plan(member, there, file=file)
