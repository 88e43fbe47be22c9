"""What a lab's file says, and what is said of one that cannot be."""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from typing import Any

import pytest

from mesh.lab.channel import Conditions
from mesh.lab.fleetfile import write_fleet
from mesh.lab.network import Network
from mesh.lab.scenario import load_scenario
from mesh.lab.values import Ask, conditions
from mesh.lab.wiring import wire
from tests.mesh.lab.conftest import scenario
from zmav.config import load_fleet
from zmav.config.table import toml_document
from zmav.errors import BadConfig, BadInput
from zmav.sim.fleetfile import load_simulated

HOSTS: dict[str, Any] = {"h1": {}, "h2": {}, "h3": {}}


@pytest.mark.parametrize("name", ["line5", "ring6", "star", "wds3", "two_radios"])
def test_every_lab_of_the_tree_makes_a_fleet_that_can_be_simulated(root: Path, tmp_path: Path, name: str) -> None:
    found = load_scenario(root / "deploy" / "labs" / f"{name}.toml")
    assert found.name == name
    fleet = write_fleet(Network(found), tmp_path)
    vehicles = [host for host, spec in found.hosts.items() if spec.vehicle]
    assert list(fleet.vehicles) == vehicles
    assert fleet.mesh.profile == found.profile
    assert fleet.mesh.insecure is not found.credentials
    simulated = load_simulated(tmp_path / "fleet.toml")
    assert [spec.name for spec in simulated.vehicles] == vehicles
    assert [spec.endpoints for spec in simulated.vehicles] == [(f"pty:{tmp_path}/{each}.pty",) for each in vehicles]


def test_the_fleet_file_says_where_everybody_is_and_what_was_said_besides(tmp_path: Path) -> None:
    found = scenario(
        hosts={"ground": {"neighbours": ["q"]}, "q": {"vehicle": "rover", "position": [3.0, 4.0], "relay": False}},
        media=[
            {"kind": "link", "between": ["ground", "q"], "interface": "wlan0"},
            {"kind": "radio", "name": "lte", "radio": "lte", "network": "10.8.0.0/16", "budget": "60 kB/s", "cost": 7},
        ],
        fleet={"fleet": "alpha", "mesh": {"lease": 0.5}, "vehicles": {"q": {"sim": {"airframe": "rover"}}}},
        profile="multi",
    )
    fleet = write_fleet(Network(found), tmp_path)
    assert (fleet.fleet, fleet.mesh.lease, fleet.mesh.profile) == ("alpha", 0.5, "multi")
    vehicle = fleet.vehicles["q"]
    assert vehicle.sim == {"autopilot": "ardurover", "airframe": "rover", "start_ned_m": [3.0, 4.0, 0.0]}
    assert [(r.interface, r.address, r.kind) for r in vehicle.mesh.radios] == [
        ("wlan0", "10.77.0.2/24", "wifi"),
        ("wwan1", "10.8.0.2/16", "lte"),
    ]
    assert (vehicle.mesh.radios[1].budget, vehicle.mesh.radios[1].cost) == ("60 kB/s", 7)
    assert not vehicle.mesh.relay
    assert fleet.stations["ground"].mesh.neighbours == ["q"]


def test_toml_is_written_as_it_is_read(tmp_path: Path) -> None:
    values = {"fleet": 'a"\\b', "sim": {"a b": [1, 2.5, True, "ü😀\n", math.inf], "c": {"d": {"e": []}}}}
    path = tmp_path / "x.toml"
    path.write_text(toml_document({**values, "fleet": "x"}))
    assert load_fleet(path).sim == values["sim"]


def test_conditions_are_said_with_units() -> None:
    ask = Ask(delay="20 ms", jitter=0.001, loss="12.5 %", rate="60 kB/s", queue="64 kB", burst=3)
    assert conditions(Conditions(), ask) == Conditions(
        delay=0.02, jitter=0.001, loss=0.125, rate=480_000.0, queue=64_000, burst=3
    )
    said: list[tuple[float | str, float | None]] = [
        ("1M", 1e6),
        ("2 Mbit/s", 2e6),
        (5000, 5e3),
        ("max", None),
        (0, None),
    ]
    for text, rate in said:
        assert conditions(Conditions(rate=7.0), Ask(rate=text)).rate == rate
    assert conditions(Conditions(loss=0.1), Ask(delay=1)).loss == 0.1  # what is not said stays


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("delay", -1, "delay is -1; expected 0 to 3600"),
        ("delay", float("nan"), "delay is nan"),
        ("loss", "110 %", "loss is 1.1; expected 0 to 1"),
        ("rate", "2 Mb/min", "such as '2 Mbit/s'"),
        ("rate", 1, "expected 100 to 1e+12"),
        ("queue", "many", "such as '64 kB'"),
        ("burst", 0.5, "burst is 0.5; expected 1 to"),
    ],
)
def test_conditions_that_cannot_be(field: str, value: Any, words: str) -> None:
    with pytest.raises(BadConfig) as caught:
        conditions(Conditions(), Ask(**{field: value}))
    assert words in str(caught.value)
    assert caught.value.detail["field"] == field


def link(**more: Any) -> dict[str, Any]:
    return {"kind": "link", "between": ["h1", "h2"], **more}


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"hosts": {}}, "a table [hosts.NAME]"),
        ({"hosts": {"Bad Name": {}}}, "'Bad Name'"),
        ({"media": [link(between=["h1", "h9"])]}, "hosts of this file: h1, h2, h3"),
        ({"media": [link(between=["h1", "h1"])]}, "each host once"),
        ({"media": [link(), link()]}, "a name of its own for each medium"),
        ({"media": [link(network="10.0.0.1/24")]}, "an IPv4 network"),
        ({"media": [link(network="10.0.0.0/31")]}, "room for 2 hosts"),
        ({"media": [link(interface="much-too-long-a-name")]}, "an interface's name"),
        ({"media": [link(interface="x"), link(name="b", interface="x")]}, "another name for each interface"),
        ({"media": [link(loss=2)]}, "media.h1-h2.loss is 2; expected 0 to 1"),
        ({"media": [link(ends={"h1>h2": {"delay": "x"}})]}, "media.h1-h2.ends.h1>h2.delay is 'x'"),
        ({"media": [{"kind": "radio", "pairs": [["h1", "h2"], ["h2", "h1"]]}]}, "each pair once"),
        ({"media": [{"kind": "radio", "hosts": ["h1"], "pairs": [["h1", "h2"]]}]}, "two hosts of h1"),
        ({"hosts": {"simulator": {}}}, "the lab's simulator is called so"),
        ({"media": [link(name="all")]}, "it stands for all links"),
        ({"media": [link(name="[/]")]}, "medium '[/]'"),
        ({"media": [link(interface="lo")]}, "an interface's name"),
        ({"media": [link(network="10.77.0.0/16"), {"kind": "radio"}]}, "one apart from 10.77.0.0/16, where h1 is"),
    ],
)
def test_scenarios_that_cannot_be(tables: dict[str, Any], words: str) -> None:
    with pytest.raises(BadInput) as caught:
        scenario(**{"hosts": HOSTS, **tables})
    assert words in str(caught.value)


@pytest.mark.parametrize("tables", [{"mesh": 5}, {"vehicles": 3}, {"stations": {"h1": 3}}])
def test_what_belongs_into_the_fleet_file_is_tables(tmp_path: Path, tables: dict[str, Any]) -> None:
    found = scenario(hosts=HOSTS, fleet=tables)
    with pytest.raises(BadConfig, match=r"fleet\.(mesh|vehicles|stations\.h1) is \d; expected a table"):
        write_fleet(Network(found), tmp_path)


def test_there_are_networks_for_as_many_links_as_a_file_has() -> None:
    names = [f"h{i}" for i in range(301)]
    media = [{"kind": "link", "between": [a, b]} for a, b in itertools.pairwise(names)]
    found = scenario(hosts={name: {} for name in names}, media=media)
    assert len({medium.network for medium in found.media}) == 300
    assert found.media[256].network == "10.78.0.0/24"


def test_ends_of_no_pair_are_refused() -> None:
    with pytest.raises(BadConfig, match=r"has 'h1-h3'; expected one of h1-h2, h1>h2"):
        wire(scenario(hosts=HOSTS, media=[link(ends={"h1-h3": {}})]))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("hosts = 3", "Expected `object`, got `int` (at hosts)"),
        ("[hosts.a]\nposition = [nan, 0]", ".position"),
        ("[hosts.a]\n[[media]]\nkind = 'cable'", "cable"),
        ("[hosts.a]\nwings = 2", "wings"),
        ("[hosts", "is not TOML"),
        (None, "cannot read the lab's file"),
    ],
)
def test_files_that_cannot_be(tmp_path: Path, text: str | None, words: str) -> None:
    path = tmp_path / "x.toml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(BadConfig) as caught:
        load_scenario(path)
    assert words in str(caught.value)
    assert str(path) in str(caught.value)


def test_links_are_found_by_the_names_people_give_them() -> None:
    hosts: dict[str, Any] = {name: {} for name in ("ground", "quad1", "quad2", "rover2")}
    wiring = wire(
        scenario(
            hosts=hosts,
            media=[
                {"kind": "radio", "name": "wifi", "hosts": ["ground", "quad1", "quad2"]},
                {"kind": "radio", "name": "lte", "hosts": ["ground", "quad1", "rover2"]},
            ],
        )
    )
    names = {edge.name: edge for edge in wiring.edges}
    assert sorted(names) == [
        "ground-quad2",
        "ground-rover2",
        "lte:ground-quad1",
        "quad1-quad2",
        "quad1-rover2",
        "wifi:ground-quad1",
    ]
    both = names["quad1-quad2"]
    for text in ("quad1-quad2", "quad2-quad1", "wifi:1-2"):
        assert sorted(wiring.find(text)[0][1]) == sorted((both.ab, both.ba)), text
    assert wiring.find("quad1>quad2") == [(both, (both.ab,))]
    assert wiring.find("quad2>1") == [(both, (both.ba,))]
    assert [edge.name for edge, _ in wiring.find("lte")] == ["lte:ground-quad1", "ground-rover2", "quad1-rover2"]
    assert len(wiring.find("all")) == 6
    for text, words in (
        ("1-2", "several links are called '1-2'; expected one of quad1-quad2, quad1-rover2"),
        ("ground-1", "several links are called 'ground-1'; expected one of wifi:ground-quad1, lte:ground-quad1"),
        ("2-9", "no link '2-9'; expected one of wifi:ground-quad1"),
        ("quad1", "no link 'quad1'"),
        ("", "no link ''"),
    ):
        with pytest.raises(BadConfig) as caught:
            wiring.find(text)
        assert words in str(caught.value)


def test_media_become_what_the_relay_makes() -> None:
    begin = wire(
        scenario(
            hosts=HOSTS,
            media=[
                link(delay="5 ms", ends={"h2>h1": {"delay": 0}}),
                {"kind": "radio", "name": "w", "hosts": ["h1", "h3"]},
                {"kind": "radio", "name": "r", "pairs": [["h2", "h3"]]},
            ],
        )
    ).begin
    assert [(edge.medium, edge.name) for edge in begin.edges] == [("h1-h2", "h1-h2"), ("w", "h1-h3"), ("r", "h2-h3")]
    assert [c.delay for c in begin.channels] == [0.005, 0.0, 0.0, 0.0, 0.0, 0.0]
    taps = begin.interfaces
    assert len({tap.mac for tap in taps}) == len({tap.address for tap in taps}) == len(taps) == 7
    assert [tap.name for tap in taps if tap.host == "h1"] == ["wlan0", "wlan1", "wlan2"]
