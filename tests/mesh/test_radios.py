"""A host's radios: what is found of them, and what makes a plan out of date."""

from __future__ import annotations

from ipaddress import ip_interface
from pathlib import Path

import pytest

from mesh.plan import RouterPlan, plan_router
from mesh.radios import Interfaces, interfaces, stand
from mesh.router import RadioWatch
from zmav.config import Radio, load_fleet
from zmav.errors import BadConfig
from zmav.session import SessionSettings

WLAN: Interfaces = {"wlan0": [ip_interface("10.77.0.1/20")]}


def test_this_computer_has_its_loopback() -> None:
    found = interfaces()
    assert any(address.ip.is_loopback for addresses in found.values() for address in addresses)
    assert all(not a.is_link_local or a.version == 4 for addresses in found.values() for a in addresses)


def test_an_interface_is_found_by_its_address_and_the_network_is_the_interface_s() -> None:
    found = stand(Radio(address="10.77.0.1"), WLAN)
    assert (found.radio.interface, str(found.address), found.present, found.fixed) == (
        "wlan0",
        "10.77.0.1/20",
        True,
        True,
    )
    assert str(stand(Radio(address="10.77.0.1/16"), WLAN).address) == "10.77.0.1/16"
    assert str(stand(Radio(address="10.77.0.1"), {}).address) == "10.77.0.1/24"
    assert str(stand(Radio(address="fd00::1"), {}).address) == "fd00::1/64"


def test_an_address_is_found_by_its_interface() -> None:
    found = stand(Radio(interface="wlan0"), WLAN)
    assert (found.radio.address, found.present, found.fixed) == ("10.77.0.1", True, False)
    both: Interfaces = {"wlan0": [ip_interface("fd00::1/64"), ip_interface("10.77.0.1/24")]}
    assert stand(Radio(interface="wlan0"), both).radio.address == "10.77.0.1"
    nothing: tuple[Interfaces, ...] = ({}, {"wlan0": []})
    for there in nothing:
        assert (stand(Radio(interface="wlan0"), there).address, stand(Radio(interface="wlan0"), there).present) == (
            None,
            False,
        )


def test_all_of_loopback_is_there() -> None:
    assert stand(Radio(address="127.3.4.5"), {}).present


def test_what_is_no_address_is_said() -> None:
    with pytest.raises(BadConfig, match=r"'10\.77' is not an IP address"):
        stand(Radio(address="10.77"), WLAN)


FLEET = """
[mesh]
profile = "PROFILE"
insecure = true
[stations.ground.mesh]
[[stations.ground.mesh.radios]]
interface = "wlan0"
"""
FIXED = 'address = "10.77.0.1"\n'


def planned(path: Path, profile: str, more: str, there: Interfaces, mesh: str = "[mesh]") -> RouterPlan:
    file = path / "fleet.toml"
    file.write_text(FLEET.replace("PROFILE", profile).replace("[mesh]", mesh, 1) + more)
    return plan_router(load_fleet(file), "ground", SessionSettings(), there=there)


@pytest.mark.parametrize("profile", ["lan", "multi"])
def test_an_address_that_was_not_known_makes_the_plan_out_of_date(tmp_path: Path, profile: str) -> None:
    watch = RadioWatch(planned(tmp_path, profile, "", {}))
    assert watch.compare({}) is None
    assert watch.compare({"wlan0": []}) is None
    assert watch.compare(WLAN) == "wlan0 has come, with 10.77.0.1"


def test_so_does_a_new_address(tmp_path: Path) -> None:
    watch = RadioWatch(planned(tmp_path, "multi", "", WLAN))
    assert watch.compare(WLAN) is None
    assert watch.compare({}) is None
    assert watch.compare(WLAN) is None  # its listener has lived through that
    assert watch.compare({"wlan0": [ip_interface("10.77.0.2/24")]}) == "wlan0 has now 10.77.0.2"


@pytest.mark.parametrize("more", ["", FIXED], ids=["by interface", "by address"])
def test_multicast_belongs_to_an_interface_as_it_was(tmp_path: Path, more: str) -> None:
    watch = RadioWatch(planned(tmp_path, "lan", more, WLAN))
    nothing: Interfaces = {"wlan0": []}
    for there in (WLAN, nothing, WLAN, {}):  # without an address for a while, it is the same interface
        assert watch.compare(there) is None
    assert str(watch.compare(WLAN)).startswith("wlan0 has come")


def test_a_fixed_address_is_waited_for_by_its_listener_unless_multicast_needs_it(tmp_path: Path) -> None:
    assert RadioWatch(planned(tmp_path, "multi", FIXED, {})).compare(WLAN) is None
    assert RadioWatch(planned(tmp_path, "lan", FIXED, {})).compare(WLAN) == "wlan0 has come"


def test_in_the_cloud_only_the_rendezvous_has_to_know_its_own_address(tmp_path: Path) -> None:
    """A modem gets another address at each dial-up, and a host that only calls need not start again for it."""
    meeting = '[mesh]\nrendezvous = ["quic/10.77.0.1:7447"]'
    far: Interfaces = {"wlan0": [ip_interface("10.99.0.7/24")]}
    for start in ({}, far):
        watch = RadioWatch(planned(tmp_path, "cloud", "", start, meeting))
        assert watch.compare({"wlan0": [ip_interface("10.99.0.8/24")]}) is None
    assert RadioWatch(planned(tmp_path, "cloud", "", {}, meeting)).compare(WLAN) == "wlan0 has come, with 10.77.0.1"


async def test_it_sees_by_itself_also_after_the_system_would_not_say(tmp_path: Path) -> None:
    failures = [OSError(24, "Too many open files")]

    def look() -> Interfaces:
        if failures:
            raise failures.pop()
        return WLAN

    watch = RadioWatch(planned(tmp_path, "lan", "", {}), look, period=0.01)
    assert await watch.outdated() == "wlan0 has come, with 10.77.0.1"
