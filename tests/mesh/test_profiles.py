"""The example fleet files, one a profile: each can be planned, and every two hosts of it can come to be linked."""

from __future__ import annotations

from ipaddress import ip_interface
from pathlib import Path

import pytest

from mesh.credentials.ca import Authority
from mesh.plan import RouterPlan, plan_router
from mesh.profiles import PROFILES
from mesh.radios import Interfaces
from zmav.config import FleetConfig, load_fleet
from zmav.session import SessionSettings
from zmav.trust.certificate import Role

FOLDER = Path(__file__).resolve().parents[2] / "deploy" / "fleets"


@pytest.fixture(params=sorted(PROFILES))
def file(request: pytest.FixtureRequest) -> FleetConfig:
    return load_fleet(FOLDER / f"{request.param}.toml")


@pytest.fixture
def plans(file: FleetConfig, tmp_path: Path) -> dict[str, RouterPlan]:
    """The plan of every host, with credentials, all radios being there."""
    authority = Authority.create(tmp_path / "ca", file.fleet)
    found = {}
    for number, (place, table) in enumerate(file.hosts().items(), 1):
        name = place.partition(".")[2]
        role = Role.VEHICLE if name in file.vehicles else Role.OPERATOR
        folder = authority.issue(name, role)
        there: Interfaces = {
            radio.interface or f"eth{each}": [radio.ip() or ip_interface(f"192.0.2.{number}/24")]
            for each, radio in enumerate(table.mesh.radios)
        }
        found[name] = plan_router(file, name, SessionSettings(credentials=str(folder)), there=there)
    return found


def test_there_is_an_example_of_each_profile(file: FleetConfig) -> None:
    assert {path.stem for path in FOLDER.glob("*.toml")} == set(PROFILES)
    assert file.mesh.profile in PROFILES


def test_every_two_hosts_can_come_to_be_linked(plans: dict[str, RouterPlan]) -> None:
    """One of the two calls the other where addresses are known; else both look on their radios, or meet elsewhere."""
    called = {
        name: {each.partition("#")[0] for each in plan.value("connect/endpoints")} for name, plan in plans.items()
    }
    for one in plans:
        for other in plans:
            if one >= other:
                continue
            a, b = plans[one], plans[other]
            calls = [bool(called[one] & set(b.listens)), bool(called[other] & set(a.listens))]
            if a.profile == "cloud":
                meeting = set(plans["meeting"].listens)
                assert all(called[each] & meeting or each == "meeting" for each in (one, other))
            elif PROFILES[a.profile].calls_all:
                assert sum(calls) == 1, f"{one} and {other}: {calls}"
            else:
                assert not any(calls)
                assert a.scouts_on
                assert b.scouts_on


def test_nobody_outside_loopback_is_listened_to_without_a_certificate(plans: dict[str, RouterPlan]) -> None:
    for plan in plans.values():
        assert all(listener.startswith(("quic/", "tcp/127.0.0.1:", "unixsock-stream/")) for listener in plan.listens)
        assert plan.value("access_control")["enabled"] is True
