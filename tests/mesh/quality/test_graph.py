"""The fleet as a graph, gathered over real routers."""

from __future__ import annotations

import asyncio
import json
import re
import time
from collections.abc import Callable

import pytest
import zenoh
from click.testing import CliRunner, Result

import mesh.graph
import zmav
from mesh import linkstate
from mesh.cli.graph import command
from mesh.graph import Graph
from tests.mesh.quality.conftest import PATIENCE_S, Routers
from tests.mesh.quality.relay import Relay
from tests.waiting import until
from zmav import keys, wire
from zmav.client import Client


class Fleet:
    """ground - quad1 - quad2 over relays, and a client at ground."""

    def __init__(self, routers: Routers) -> None:
        self.routers = routers
        self.relays: dict[str, Relay] = {}
        self.endpoint = ""
        self.tokens: list[zenoh.LivelinessToken] = []

    async def line(self) -> None:
        routers = self.routers
        port = await routers.open("ground", listen=("tcp/127.0.0.1:0",))
        self.endpoint = next(each for each in routers.locators("ground") if each.startswith("tcp/"))
        for name in ("quad1", "quad2"):
            relay = self.relays[name] = routers.relay(port)
            port = await routers.open(name, relay.endpoint)
        for name in routers.sessions:
            self.alive(name)
            await routers.measure(name)

    def alive(self, name: str) -> None:
        session = self.routers.sessions[name]
        role = "router" if name == "ground" else keys.VEHICLE
        instance = session.info.zid()
        key = keys.ALIVE.key("demo", name, role=role, sys=0, autopilot="-", uid="-", instance=instance)
        self.tokens.append(session.liveliness().declare_token(key))


@pytest.fixture
async def fleet(routers: Routers) -> Fleet:
    fleet = Fleet(routers)
    await fleet.line()
    return fleet


async def gathered(z: Client, true: Callable[[Graph], object], what: str) -> Graph:
    """The first graph that is as wanted."""
    end = time.monotonic() + PATIENCE_S
    while not true(graph := await mesh.graph.gather(z)):
        assert time.monotonic() < end, f"no graph with {what}: {graph}"
    return graph


def both_ends(graph: Graph) -> bool:
    """Every link is measured from both ends."""
    return len(graph.links) == 2 and all(
        link.rtt is not None and None not in (link.loss(link.a), link.loss(link.b)) and link.by_a and link.by_b
        for link in graph.links
    )


def roles(graph: Graph) -> list[str]:
    return [node.role for node in graph.nodes.values() if node.role]


async def test_the_way_through_a_chain_and_its_weakest_hop(fleet: Fleet) -> None:
    fleet.relays["quad1"].delay = [0.005, 0.005]
    fleet.relays["quad2"].delay = [0.04, 0.04]
    async with zmav.open(connect=[fleet.endpoint]) as z:
        graph = await gathered(z, lambda g: both_ends(g) and len(roles(g)) == 3, "both ends")
        assert graph.start == "ground"
        assert {(n.name, n.role, n.answers) for n in graph.nodes.values()} == {
            ("ground", "router", True),
            ("quad1", "vehicle", True),
            ("quad2", "vehicle", True),
        }
        assert [(link.a, link.b, link.state) for link in graph.links] == [
            ("ground", "quad1", "up"),
            ("quad1", "quad2", "up"),
        ]
        way = graph.ways["quad2"]
        assert (way.hops, way.complete, way.traced) == (("ground", "quad1", "quad2"), True, True)
        weakest = way.weakest
        assert weakest is not None and (weakest.a, weakest.b) == ("quad1", "quad2")
        assert way.rtt is not None and way.rtt >= 0.09
        there, back = way.delivery(), way.delivery(back=True)
        assert there is not None and back is not None and 0.0 < there <= 1.0 and 0.0 < back <= 1.0
        near = graph.ways["quad1"].weakest
        assert near is not None and (near.a, near.b) == ("ground", "quad1")


async def test_after_a_cut_the_next_graph_shows_the_other_way(fleet: Fleet) -> None:
    """A triangle: quad2 is linked to ground, too, over a relay that is cut."""
    relay = fleet.routers.relay(int(fleet.relays["quad1"].target[1]))
    await fleet.routers.open("quad3", relay.endpoint, fleet.relays["quad2"].endpoint)
    fleet.alive("quad3")
    await fleet.routers.measure("quad3")
    ground = fleet.routers.sessions["ground"]
    async with zmav.open(connect=[fleet.endpoint]) as z:
        direct = ("ground", "quad3")
        await gathered(z, lambda g: "quad3" in g.ways and g.ways["quad3"].hops == direct, "the direct way")
        relay.cut()
        zid = str(fleet.routers.sessions["quad3"].info.zid())

        await until(lambda: zid not in map(str, ground.info.routers_zid()), "ground knows of the cut")
        assert (await mesh.graph.gather(z)).ways["quad3"].hops == ("ground", "quad1", "quad3")
        graph = await gathered(z, lambda g: states(g).get(direct) == "down", "the cut link, which is down")
        assert [link.grade for link in graph.links if (link.a, link.b) == direct] == ["down"]
        assert graph.ways["quad3"].hops == ("ground", "quad1", "quad3")


def states(graph: Graph) -> dict[tuple[str, str], str]:
    return {(link.a, link.b): link.state for link in graph.links}


async def test_the_map_weighs_links_as_the_routers_do(routers: Routers) -> None:
    """A ring of four has two ways of two hops: which one it is lies in the weights. Zenoh's own map, which can freeze a
    router, is asked for when all have joined."""
    ports: list[int] = []
    for name in ("a", "b", "c", "d"):
        others = ports if name == "d" else ports[-1:]
        ports.append(await routers.open(name, *(f"udp/127.0.0.1:{port}?rel=1;mixed_rel=1" for port in others[::2])))
    sessions, end = routers.sessions, time.monotonic() + PATIENCE_S
    told: dict[str, bytes] = {}
    while sorted(map(len, (links := linkstate.read(told)).values())) != [2, 2, 2, 2]:
        assert time.monotonic() < end, f"no ring: {links}"
        answers = [reply.ok for reply in sessions["a"].get(linkstate.ASKED) if reply.ok is not None]
        told = {str(each.key_expr).split("/")[1]: each.payload.to_bytes() for each in answers}
    own = str(sessions["a"].info.zid())
    (reply,) = sessions["a"].get(f"@/{own}/router/linkstate/north")
    assert reply.ok is not None
    text = reply.ok.payload.to_bytes().decode()
    ids = dict(re.findall(r'(\d+) \[ label = "([0-9a-f]+)" \]', text))
    weights = re.findall(r'(\d+) -- (\d+) \[ label = "([0-9.]+)" \]', text)
    assert len(weights) == 4
    for one, other, weight in weights:
        assert links[ids[one]][ids[other]] == pytest.approx(float(weight), abs=1e-6)


async def test_hostile_answers_are_counted_and_left_out(fleet: Fleet) -> None:
    good = wire.NeighbourQuality(
        t=1.0, name="quad8", router="ab", peer="cd", url="udp/1.2.3.4:5", state="up", rtt=0.1, loss_in=0.5
    )
    lies: list[tuple[str, bytes]] = [
        ("quad8", wire.encode(good)),  # the only one that is as it should be
        ("a", b""),
        ("b", b"{"),
        ("c", b"[" * 100_000),
        ("d", b'{"kind":"neighbour"}'),
        ("e", wire.encode(good)),  # another's name
        ("f", wire.encode(good).replace(b'"loss_in":0.5', b'"loss_in":1e308').replace(b"quad8", b"f")),
        ("g", wire.encode(good).replace(b'"rtt":0.1', b'"rtt":-1').replace(b"quad8", b"g")),
        ("h", wire.encode(good).replace(b'"ab"', b'"*/router/**"').replace(b"quad8", b"h")),
        ("Ünn", wire.encode(good).replace(b"quad8", "Ünn".encode())),
        ("j", b"\xff\xfe"),
    ]

    def answer(query: zenoh.Query) -> None:
        for link, data in lies:
            query.reply(keys.LINK.key("demo", "quad9", link=link), data, encoding=keys.JSON)

    hostile = fleet.routers.sessions["quad2"]
    hostile.declare_queryable(keys.LINK.key("demo", "quad9", link="*"), answer)
    token = keys.ALIVE.key("demo", "quad9", role=keys.VEHICLE, sys="x", autopilot="y", uid="z", instance="no-id")
    fleet.tokens.append(hostile.liveliness().declare_token(token))
    async with zmav.open(connect=[fleet.endpoint]) as z:
        lied = len(lies) - 1
        graph = await gathered(z, lambda g: g.bad == lied and both_ends_but(g, "quad9"), "lies, and the others' links")
        assert {(link.a, link.b) for link in graph.links if "quad9" in (link.a, link.b)} == {("quad8", "quad9")}
        assert graph.nodes["quad8"].answers is False
        assert graph.ways["quad8"].complete is False
        assert graph.ways["quad2"].complete is True


def both_ends_but(graph: Graph, name: str) -> bool:
    honest = [link for link in graph.links if name not in (link.a, link.b)]
    return len(honest) == 2 and all(link.by_a and link.by_b for link in honest)


# As a person has it.


async def test_the_verb_shows_links_and_ways(fleet: Fleet) -> None:
    async with zmav.open(connect=[fleet.endpoint]) as z:
        await gathered(z, both_ends, "both ends")

    def shown(*arguments: str) -> Result:
        return CliRunner().invoke(command, ["-e", fleet.endpoint, *arguments])

    table = await asyncio.to_thread(shown)
    assert table.exit_code == 0, table.output
    assert "ground - quad1" in table.output and "ground > quad1 > quad2" in table.output
    document = json.loads((await asyncio.to_thread(shown, "--json")).output)
    assert document["ways"]["quad2"]["hops"] == ["ground", "quad1", "quad2"]
    assert {tuple(link["ends"]) for link in document["links"]} == {("ground", "quad1"), ("quad1", "quad2")}
    assert document["bad"] == 0
