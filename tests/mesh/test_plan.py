"""What a router is opened with: from the fleet file, the profile, the host's interfaces and what a person gave."""

from __future__ import annotations

import json
from collections.abc import Callable
from ipaddress import ip_interface
from pathlib import Path
from typing import Any

import pytest

from mesh.credentials.ca import Authority
from mesh.plan import RouterPlan, plan_router
from mesh.radios import Interfaces
from zmav.config import load_fleet
from zmav.errors import BadConfig, BadKey
from zmav.session import SessionSettings, config
from zmav.trust.certificate import Role

FLEET = """
fleet = "alpha"
[mesh]
profile = "PROFILE"
insecure = true
[vehicles.quad1]
link = "/dev/ttyAMA0"
[[vehicles.quad1.mesh.radios]]
interface = "wlan0"
address = "10.77.0.1"
[[vehicles.quad1.mesh.radios]]
interface = "wwan0"
kind = "lte"
address = "10.8.1.1/16"
[vehicles.quad2]
link = "/dev/ttyAMA0"
[[vehicles.quad2.mesh.radios]]
interface = "wlan0"
address = "10.77.0.2"
[[vehicles.quad2.mesh.radios]]
interface = "wwan0"
kind = "lte"
address = "10.8.2.2/16"
port = 7500
[stations.ground.mesh]
[[stations.ground.mesh.radios]]
address = "10.77.0.9"
kind = "ethernet"
[stations.far.mesh]
[[stations.far.mesh.radios]]
address = "192.0.2.9"
"""
NAMED = '[vehicles.quad1.mesh]\nneighbours = ["quad2"]\n'
THERE: Interfaces = {
    "lo": [ip_interface("127.0.0.1/8")],
    "wlan0": [ip_interface("10.77.0.1/24")],
    "wwan0": [ip_interface("10.8.1.1/16")],
}
Plan = Callable[..., RouterPlan]


@pytest.fixture
def plan(tmp_path: Path) -> Plan:
    def plan(
        text: str = FLEET, name: str = "quad1", profile: str = "lan", there: Interfaces = THERE, **given: Any
    ) -> RouterPlan:
        path = tmp_path / "fleet.toml"
        path.write_text(text.replace("PROFILE", profile))
        return plan_router(load_fleet(path), name, SessionSettings(**given), there=there)

    return plan


def udp(*places: str, by: str = "") -> list[str]:
    """Endpoints; ``by`` is the address of the radio that they are called from."""
    return [f"udp/{place}?rel=1;mixed_rel=1{f'#bind={by}:0' if by else ''}" for place in places]


def test_without_a_file_it_keeps_to_loopback() -> None:
    alone = plan_router(None, "ground", SessionSettings())
    assert (alone.fleet, alone.name, alone.neighbours, alone.vehicle) == ("demo", "ground", (), False)
    assert alone.listens == ["tcp/127.0.0.1:7447"]
    assert alone.value("connect/endpoints") == []
    assert alone.value("scouting/multicast/enabled") is False
    assert plan_router(None, "quad1", SessionSettings(), vehicle=True, fleet="beta").vehicle


def test_local_programs_and_each_radio_have_a_listener(plan: Plan) -> None:
    assert plan().listens == ["tcp/127.0.0.1:7447", *udp("10.77.0.1:7447", "10.8.1.1:7447")]
    assert plan(name="quad2", there={}).listens == ["tcp/127.0.0.1:7447", *udp("10.77.0.2:7447", "10.8.2.2:7500")]


def test_who_is_found_by_multicast_over_a_bad_radio_listens_on_two_ports(plan: Plan) -> None:
    """One of them a half-open call may hold; what is called by address, or past a budget, has one."""
    two = ["tcp/127.0.0.1:7447", *udp("10.77.0.1:7447", "10.77.0.1:7449", "10.8.1.1:7447", "10.8.1.1:7449")]
    one = ["tcp/127.0.0.1:7447", *udp("10.77.0.1:7447", "10.8.1.1:7447")]
    assert plan(profile="mesh").listens == two
    assert plan(profile="wds").listens == plan(profile="multi").listens == one
    named = FLEET.replace("[[vehicles.quad1.mesh.radios]]", NAMED + "[[vehicles.quad1.mesh.radios]]", 1)
    assert plan(named, profile="mesh").listens == one
    budget = FLEET.replace('address = "10.77.0.1"', 'address = "10.77.0.1"\nbudget = "60 kB/s"')
    assert plan(budget, profile="mesh").listens == [each for each in two if "10.77.0.1:7449" not in each]
    beside = FLEET.replace('address = "10.77.0.2"', 'address = "10.77.0.1"\nport = 7449')
    assert beside != FLEET
    assert plan(beside, profile="mesh").listens == [each for each in two if "10.77.0.1:7449" not in each]


@pytest.mark.parametrize(("profile", "scouts"), [("lan", True), ("wds", False), ("mesh", True), ("multi", False)])
def test_scouting_is_on_the_radios_and_between_routers_only(plan: Plan, profile: str, scouts: bool) -> None:
    found = plan(profile=profile)
    assert found.value("scouting/multicast/enabled") is scouts
    assert found.scouts_on == (("wlan0", "wwan0") if scouts else ())
    if scouts:
        assert found.value("scouting/multicast/autoconnect") == {"router": ["router"], "peer": [], "client": []}
        assert found.value("scouting/multicast/autoconnect_strategy") == "greater-zid"
        assert found.value("scouting/multicast/ttl") == 1


@pytest.mark.parametrize(("profile", "called"), [("lan", False), ("wds", True), ("mesh", False), ("multi", True)])
def test_who_is_called_where_nobody_is_named(plan: Plan, profile: str, called: bool) -> None:
    found = plan(profile=profile)
    assert [n.name for n in found.neighbours] == (["quad2", "ground"] if called else [])
    # One way each: the cheapest. Of two, the first in the alphabet calls: ground calls quad1.
    assert found.value("connect/endpoints") == (udp("10.77.0.2:7447", by="10.77.0.1") if called else [])
    assert plan(name="ground", profile=profile, there={}).value("connect/endpoints") == (
        udp("10.77.0.1:7447", "10.77.0.2:7447", by="10.77.0.9") if called else []
    )


def test_in_a_large_fleet_each_is_linked_with_a_few_and_all_are_joined(plan: Plan) -> None:
    hosts = [f"h{number}" for number in range(1, 31)]
    radios = "".join(f'[[stations.h{n}.mesh.radios]]\naddress = "10.77.0.{n}"\n' for n in range(1, 31))
    text = f'[mesh]\nprofile = "wds"\ninsecure = true\n{radios}'
    plans = {name: plan(text, name, there={}) for name in hosts}
    linked = {name: {n.name for n in each.neighbours} for name, each in plans.items()}
    assert all(name in linked[other] for name in hosts for other in linked[name])  # both know of it
    assert max(map(len, linked.values())) <= 8
    for away in (set(), {"h3"}, {"h3", "h4", "h5"}, {"h10", "h20", "h30"}):
        joined, edge = set[str](), {"h1"}
        while edge:
            joined |= edge
            edge = {far for near in edge for far in linked[near]} - joined - away
        assert joined == set(hosts) - away
    calls = sum(len(each.value("connect/endpoints")) for each in plans.values())
    assert calls == sum(map(len, linked.values())) / 2


def test_where_an_address_is_not_known_it_is_looked_for_and_who_has_it_calls(plan: Plan) -> None:
    text = FLEET.replace('interface = "wlan0"\naddress = "10.77.0.2"', 'interface = "wlan0"')
    assert plan(text, profile="wds").scouts_on == ("wlan0", "wwan0")
    text = FLEET.replace('address = "10.77.0.9"', 'interface = "eth0"')
    ground = plan(text, "ground", "wds", there={"eth0": [ip_interface("10.77.0.9/24")]})
    assert ground.value("connect/endpoints") == udp("10.77.0.1:7447", "10.77.0.2:7447", by="10.77.0.9")
    quad2 = plan(text, "quad2", "wds", there={"wlan0": [ip_interface("10.77.0.2/24")]})
    assert quad2.value("connect/endpoints") == []
    assert quad2.scouts_on == ("wlan0",)


def test_the_cheaper_way_is_first(plan: Plan) -> None:
    for cost, first in ((None, "10.77.0.2"), (1, "10.8.2.2"), (10_000, "10.77.0.2")):
        told = "" if cost is None else f"cost = {cost}\n"
        found = plan(FLEET.replace('kind = "lte"\n', f'kind = "lte"\n{told}'), profile="wds")
        assert found.neighbours[0].ways[0].address == first


def test_who_names_its_neighbours_is_linked_with_no_other(plan: Plan) -> None:
    named = FLEET.replace('link = "/dev/ttyAMA0"', 'link = "x"\nmesh.neighbours = ["ground", "udp/203.0.113.5:7"]', 1)
    for profile in ("lan", "wds", "mesh", "multi", "cloud"):
        found = plan(named, profile=profile)
        assert [n.name for n in found.neighbours] == ["ground"]
        calls = [] if profile in ("wds", "multi") else udp("10.77.0.9:7447", by="10.77.0.1")
        assert found.value("connect/endpoints") == [*calls, "udp/203.0.113.5:7"]
        assert found.scouts_on == ()
        assert [n.name for n in plan(named, "quad2", "multi").neighbours] == ["ground"]  # quad1 has said whom it wants
    assert "vehicles.quad1.mesh.neighbours" in found.settings["connect/endpoints"].source


CLOUD = FLEET.replace("insecure = true", 'insecure = true\nrendezvous = ["udp/192.0.2.9:7447?rel=1;mixed_rel=1"]')


def test_in_the_cloud_only_the_rendezvous_can_be_called(plan: Plan) -> None:
    quad, far = plan(CLOUD, profile="cloud"), plan(CLOUD, "far", "cloud")
    assert quad.listens == ["tcp/127.0.0.1:7447"]
    assert quad.value("connect/endpoints") == udp("192.0.2.9:7447")
    assert far.listens == ["tcp/127.0.0.1:7447", *udp("192.0.2.9:7447")]
    assert far.value("connect/endpoints") == []
    for written in ("udp/192.0.2.9:7447", "udp/192.0.2.9:7447?rel=1#iface=eth0"):  # its own, however it is written
        other = plan(CLOUD.replace("udp/192.0.2.9:7447?rel=1;mixed_rel=1", written), "far", "cloud")
        assert (other.listens[1:], other.value("connect/endpoints")) == (udp("192.0.2.9:7447"), [])
    assert quad.value("transport/link/tx/lease") / quad.value("transport/link/tx/keep_alive") < 20_000  # ms


def test_a_radio_without_an_address_has_its_interface_s(plan: Plan) -> None:
    text = FLEET.replace('address = "10.77.0.1"\n', "")
    found = plan(text, profile="wds")
    assert found.host.radios[0].address == "10.77.0.1"
    assert found.listens[1] == udp("10.77.0.1:7447")[0]
    there = {**THERE, "wlan0": [ip_interface("2001:db8::7/64")]}
    assert plan(text, there=there).listens[1] == udp("[2001:db8::7]:7447")[0]


def test_a_radio_that_is_not_there_yet_is_waited_for(plan: Plan) -> None:
    found = plan(there={"lo": THERE["lo"], "wlan0": THERE["wlan0"]})
    assert [radio.present for radio in found.radios] == [True, False]
    assert found.listens == ["tcp/127.0.0.1:7447", *udp("10.77.0.1:7447", "10.8.1.1:7447")]
    assert (found.value("listen/timeout_ms"), found.value("listen/exit_on_failure")) == (-1, False)
    assert "wwan0 (waited for)" in found.settings["listen/endpoints"].source
    assert found.scouts_on == ("wlan0",)
    assert plan().value("listen/timeout_ms") is None
    assert plan(there={}).settings["scouting/multicast/enabled"].source == "no radio is there yet"


def test_where_a_radio_has_a_budget_there_are_fewer_words(plan: Plan) -> None:
    paths = ("transport/link/tx/lease", "transport/link/tx/keep_alive")
    slow = FLEET.replace('address = "10.77.0.1"\n', 'address = "10.77.0.1"\nbudget = "60 kB/s"\n', 1)
    for profile in ("wds", "mesh"):
        plain, budget, other = plan(profile=profile), plan(slow, profile=profile), plan(slow, "quad2", profile)
        assert plain.value(paths[0]) < 1000
        for found in (budget, other):
            assert [found.value(path) for path in paths] == [3000, 6]
    for profile in ("lan", "multi"):
        before, after = plan(profile=profile), plan(slow, profile=profile)
        assert [before.value(path) for path in paths] == [after.value(path) for path in paths]


def test_timers_come_from_the_profile_or_the_file(plan: Plan) -> None:
    by_profile = plan(profile="cloud").settings["transport/link/tx/lease"]
    assert by_profile.source == "profile cloud"
    found = plan(FLEET.replace("[mesh]", "[mesh]\nlease = 3.0\nkeep_alive = 6\nretry = 0.1"))
    assert found.settings["transport/link/tx/lease"].source == "fleet file: mesh.lease"
    assert found.value("transport/link/tx/lease") == 3000
    assert found.value("transport/link/tx/keep_alive") == 6
    assert found.value("connect/retry")["period_max_ms"] == found.value("connect/retry")["period_init_ms"] == 100


def test_a_hosts_own_profile_goes_before_the_fleets(plan: Plan) -> None:
    text = FLEET.replace("[stations.far.mesh]", '[stations.far.mesh]\nprofile = "multi"')
    assert (plan(text, "far").profile, plan(text).profile) == ("multi", "lan")


def test_what_a_person_gave_wins_and_says_so(plan: Plan, tmp_path: Path) -> None:
    file = tmp_path / "zenoh.json5"
    file.write_text("{transport: {link: {tx: {lease: 4321}}}, scouting: {multicast: {ttl: 3}}}")
    given: dict[str, Any] = {
        "listen": ["tcp/127.0.0.1:1"],
        "connect": ["tcp/127.0.0.1:2"],
        "file": str(file),
        "cfg": ["transport/link/tx/keep_alive:7", "queries_default_timeout:5"],
    }
    found = plan(**given)
    expected = {
        "listen/endpoints": (["tcp/127.0.0.1:1"], "-l"),
        "connect/endpoints": (["tcp/127.0.0.1:2"], "-e"),
        "transport/link/tx/lease": (4321, f"-c {file}"),
        "scouting/multicast/ttl": (3, f"-c {file}"),
        "transport/link/tx/keep_alive": (7, "--cfg"),
        "queries_default_timeout": (5, "--cfg"),
    }
    built = config(found.session(SessionSettings(**given)))
    for path, (value, source) in expected.items():
        assert (found.value(path), found.settings[path].source) == (value, source)
        assert json.loads(built.get_json(path)) == value


def test_every_value_is_one_that_zenoh_takes_and_says_its_source(plan: Plan) -> None:
    for profile in ("lan", "wds", "mesh", "multi", "cloud"):
        found = plan(CLOUD, profile=profile, there={})
        built = config(found.session(SessionSettings()))
        for path, setting in found.settings.items():
            assert setting.source
            taken = json.loads(built.get_json(path))
            if isinstance(setting.value, list):  # Zenoh sorts what stands behind the question mark
                assert len(taken) == len(setting.value)
            elif not isinstance(setting.value, dict):
                assert taken == setting.value


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        ('profile = "PROFILE"', 'profile = "wifi"', "Invalid enum value 'wifi'"),
        ('"10.77.0.9"', '"10.77.0.1"', "ground.mesh.radios[0].address is 10.77.0.1; expected another one than"),
        ('"10.77.0.9"', '"ten"', "'ten' is not an IP address"),
        ('"10.77.0.9"', '"10.77.0.0/24"', "not the network's own"),
        ('"10.77.0.9"', '"0.0.0.0"', "one host's own address"),
        ('address = "10.77.0.9"', "", "expected one of the two at least"),
        ("[stations.far.mesh]", '[stations.far.mesh]\nneighbours = ["quad9"]', "one of ground, quad1, quad2"),
        ("[stations.far.mesh]", '[stations.far.mesh]\nneighbours = ["far"]', "another host's name"),
        ("insecure = true", 'rendezvous = ["192.0.2.9"]', "a Zenoh endpoint"),
        ("insecure = true", "thin = {'a b' = 1}", "cannot be a message's name"),
        ("insecure = true", "lease = 0", "> 0"),
        ("insecure = true", "", "let others in unguarded: there are no credentials"),
        ("[stations.ground.mesh]", "[stations.quad1.mesh]", "a name that no vehicle has"),
    ],
)
def test_what_cannot_be_is_said(plan: Plan, before: str, after: str, words: str) -> None:
    assert before in FLEET
    with pytest.raises((BadConfig, BadKey)) as caught:
        plan(FLEET.replace(before, after))
    assert words in caught.value.message


def test_a_neighbour_that_no_radio_reaches_is_said_with_what_to_do(plan: Plan) -> None:
    text = FLEET.replace("[stations.far.mesh]", '[stations.far.mesh]\nneighbours = ["quad1"]')
    with pytest.raises(BadConfig, match=r"far cannot reach its neighbour quad1: its addresses \(10\.77\.0\.1, ") as e:
        plan(text, "far")
    assert "192.0.2.0/24" in e.value.message
    found = plan(text.replace('"192.0.2.9"', '"10.77.0.77"'), "far")
    assert found.value("connect/endpoints") == udp("10.77.0.1:7447", by="10.77.0.77")


def test_an_address_on_another_interface_than_the_file_says_is_said(plan: Plan) -> None:
    with pytest.raises(BadConfig, match=r"10\.77\.0\.1 is the address of eth7 here; the fleet file has it on wlan0"):
        plan(there={"eth7": THERE["wlan0"]})


def test_a_host_that_the_file_has_not(plan: Plan) -> None:
    with pytest.raises(BadConfig, match="no host 'quad9' in the fleet file; it has quad1, quad2, ground, far"):
        plan(name="quad9")


@pytest.fixture(scope="module")
def authority(tmp_path_factory: pytest.TempPathFactory) -> Authority:
    authority = Authority.create(tmp_path_factory.mktemp("ca") / "alpha", "alpha")
    authority.issue("quad1", Role.VEHICLE)
    authority.issue("quad2", Role.OPERATOR)
    return authority


def test_with_credentials_routers_speak_quic_behind_rules(plan: Plan, authority: Authority) -> None:
    folder = authority.folder / "members" / "quad1"
    found = plan(FLEET.replace("insecure = true", ""), profile="wds", credentials=str(folder))
    assert found.listens[1] == "quic/10.77.0.1:7447?mixed_rel=1"
    assert found.value("connect/endpoints")[0] == "quic/10.77.0.2:7447?mixed_rel=1#bind=10.77.0.1:0"
    assert found.value("transport/link/tls/enable_mtls") is True
    assert found.value("access_control")["default_permission"] == "deny"
    assert "roster" in found.settings["access_control"].source
    assert found.settings["transport/link/tls/enable_mtls"].source == f"credentials {folder}"


@pytest.mark.parametrize(
    ("name", "member", "fleet", "words"),
    [
        ("quad2", "quad1", "alpha", "are the credentials of the name 'quad1', and this router's is 'quad2'"),
        ("quad1", "quad1", "beta", "are the credentials of the fleet 'alpha', and this router's is 'beta'"),
        ("quad2", "quad2", "alpha", "quad2 is a vehicle, and its certificate is for the role 'operator'"),
    ],
)
def test_another_s_credentials_are_refused(
    plan: Plan, authority: Authority, name: str, member: str, fleet: str, words: str
) -> None:
    with pytest.raises(BadConfig) as caught:
        plan(FLEET.replace("alpha", fleet), name, credentials=str(authority.folder / "members" / member))
    assert words in caught.value.message
