"""Links, ways and how they are drawn, without any network."""

from __future__ import annotations

import itertools
import json

import pytest

from mesh import linkstate
from mesh.cli.graph import document, view, way_words
from mesh.graph import Findings, Graph, Node
from zmav import keys, wire
from zmav.client import Answer
from zmav.doctor.ways import Link, Way


def said(name: str, state: wire.LinkState = "up", **figures: object) -> wire.NeighbourQuality:
    known = {"t": 1.0, "name": name, "router": "aa", "peer": "bb", "url": "udp/1.2.3.4:5", "state": state, **figures}
    return wire.NeighbourQuality(**known)  # type: ignore[arg-type]


def link(a: str, b: str, **figures: object) -> Link:
    return Link(a, b, said(b, **figures), said(a, **figures))  # type: ignore[arg-type]


CLEAN = {"rtt": 0.01, "loss_in": 0.0, "loss_out": 0.0, "cost": 600}
FIRST = link("a", "b", **CLEAN)


@pytest.mark.parametrize(
    "worse",
    [
        link("b", "c", **{**CLEAN, "state": "down"}),
        link("b", "c", **{**CLEAN, "loss_in": 0.1, "rtt": 0.001}),
        link("b", "c", **{**CLEAN, "rtt": 0.02}),
    ],
    ids=["down", "loss", "round trip"],
)
def test_the_weakest_hop_is_the_one_that_is_worse(worse: Link) -> None:
    for links in ((FIRST, worse), (worse, FIRST)):
        assert Way(("a", "b", "c"), links).weakest is worse


def test_one_thing_after_the_other_makes_a_hop_weak() -> None:
    down = link("a", "b", state="down")
    lossy = link("b", "c", **{**CLEAN, "loss_in": 0.3})
    slow = link("c", "d", **{**CLEAN, "rtt": 0.5})
    mixed = [FIRST, down, slow, lossy]
    assert sorted(mixed, key=Link.badness, reverse=True) == [down, lossy, slow, FIRST]


def test_an_asymmetric_link_is_told_from_where_it_is_received() -> None:
    one = Link("a", "b", said("b", loss_in=0.1, loss_out=0.9), said("a", loss_in=0.4, loss_out=0.8))
    assert (one.loss("a"), one.loss("b"), one.worst_loss) == (0.4, 0.1, 0.4)
    alone = Link("a", "b", said("b", loss_in=0.1, loss_out=0.9))
    assert (alone.loss("a"), alone.loss("b")) == (0.9, 0.1)
    assert Link("a", "b").state == "unknown"
    assert Link("a", "b", said("b"), said("a", "down")).state == "down"


def test_a_way_adds_round_trips_and_multiplies_delivery() -> None:
    second = Link("b", "c", said("c", rtt=0.03, loss_in=0.5), said("b", rtt=0.05, loss_in=0.2))
    way = Way(("a", "b", "c"), (FIRST, second))
    assert way.rtt == pytest.approx(0.05)
    assert way.delivery() == pytest.approx(0.8)
    assert way.delivery(back=True) == pytest.approx(0.5)
    unknown = Way(("a", "b", "c"), (FIRST, Link("b", "c")))
    assert (unknown.rtt, unknown.delivery()) == (None, None)
    lost = Way(("a",), (), complete=False)
    assert (lost.rtt, lost.delivery(), lost.weakest) == (None, None, None)
    assert way_words(lost) == "a > ?"


@pytest.mark.parametrize(
    ("figures", "grade"),
    [
        (CLEAN, "good"),
        ({**CLEAN, "loss_out": 0.06, "loss_in": 0.06}, "fair"),
        ({**CLEAN, "cost": 5_000}, "fair"),
        ({**CLEAN, "loss_in": 0.2}, "poor"),
        ({**CLEAN, "cost": 20_000}, "poor"),
        ({**CLEAN, "state": "silent"}, "down"),
        ({}, "unknown"),
    ],
)
def test_a_links_grade(figures: dict[str, object], grade: str) -> None:
    assert link("a", "b", **figures).grade == grade


# The routers' map.


def router(*peers: str) -> bytes:
    sessions = [{"peer": peer, "whatami": "router", "links": []} for peer in peers]
    return json.dumps({"zid": "aa", "sessions": [*sessions, {"peer": "ee", "whatami": "client"}]}).encode()


def test_a_map_and_the_ways_of_least_weight_over_it() -> None:
    """``dd`` does not answer; ``bb`` no longer tells of the link that ``cc`` still tells of."""
    links = linkstate.read({"aa": router("bb", "cc", "dd"), "bb": router("aa"), "cc": router("aa", "bb"), "x": b""})
    assert {zid: set(near) for zid, near in links.items()} == {
        "aa": {"bb", "cc", "dd"},
        "bb": {"aa"},
        "cc": {"aa"},
        "dd": {"aa"},
    }
    assert all(100.0 <= weight <= 101.0 for near in links.values() for weight in near.values())
    heavy = {"aa": {"bb": 100.3, "cc": 1000.8}, "bb": {"aa": 100.3, "cc": 100.1}, "cc": {"bb": 100.1, "aa": 1000.8}}
    assert linkstate.ways(heavy, "aa") == {"aa": ["aa"], "bb": ["aa", "bb"], "cc": ["aa", "bb", "cc"]}
    assert linkstate.ways({"dd": {}}, "dd") == {"dd": ["dd"]}


@pytest.mark.parametrize(("key", "zid"), [("@/a1/router", "a1"), ("@/*/router", None), ("@/a1/router/x", None)])
def test_whose_answer_it_is(key: str, zid: str | None) -> None:
    assert linkstate.zid_of(key) == zid


# What hosts say.


def test_a_silent_host_is_known_by_its_token_and_its_neighbours() -> None:
    found = Findings(several=False)
    token = {"role": "router", "sys": 0, "autopilot": "-", "uid": "-"}
    found.present([keys.ALIVE.key("demo", "relay", instance="cc", **token), "zmav/nonsense"])
    told = {"quad2": "bb", "cc": "cc"}
    found.read(
        [Answer(keys.LINK.key("demo", "quad1", link=n), wire.encode(said(n, peer=zid))) for n, zid in told.items()]
    )
    assert found.bad == 1
    assert found.missing() == [("demo", "cc"), ("demo", "quad2"), ("demo", "relay")]
    nodes = found.nodes()
    assert {(n.name, n.zid, n.role, n.answers) for n in nodes.values()} == {
        ("quad1", "aa", None, True),
        ("quad2", "bb", None, False),
        ("relay", "cc", "router", False),
    }
    assert set(found.links()) == {("quad1", "quad2"), ("quad1", "relay")}


def test_hosts_of_several_fleets_are_told_apart() -> None:
    found = Findings(several=True)
    for fleet, zid in (("north", "aa"), ("south", "cc")):
        quality = said("quad2", router=zid, peer=zid + "00")
        found.read([Answer(keys.LINK.key(fleet, "quad1", link="quad2"), wire.encode(quality))])
    assert set(found.links()) == {(f"{fleet}/quad1", f"{fleet}/quad2") for fleet in ("north", "south")}


# As it is drawn.


def graph_of(*names: str) -> Graph:
    nodes = {name: Node(name, None, "vehicle" if number else None, bool(number)) for number, name in enumerate(names)}
    links = [link(a, b, **CLEAN) for a, b in itertools.pairwise(names)]
    return Graph(1.0, names[0], nodes, (*links, link("x", "y", state="down", loss_in=0.123)))


def test_tables_and_documents_of_odd_graphs() -> None:
    for graph in (Graph(1.0, None), graph_of("a"), graph_of("a", "b", "c")):
        assert view(graph).renderables
        assert document(graph)["start"] == graph.start
