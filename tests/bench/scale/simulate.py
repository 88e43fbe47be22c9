"""Run a fleet as one flat network, or as a hierarchy: each group a network of its own, joined by its gateway."""

from __future__ import annotations

import socket
import time

from tests.bench.scale.fleet import Child, ask_all, until
from tests.bench.scale.study import FLEET, GATEWAY, NODE, Network, Run, Shape, endpoint, know, measure
from zmav.children import Children
from zmav.process import free_port


def simulate(shape: Shape) -> Run:
    """Run it: some ten seconds and as long as the machine takes to form the fleet."""
    with Children(at_once=True) as children:
        return _grouped(children, shape) if shape.groups else _flat(children, shape)


def _flat(children: Children, shape: Shape) -> Run:
    network = Network(children, "router", shape.topology, shape.routers)
    network.ready()
    until(network.formed, "every router has a neighbour")
    start = time.monotonic()
    network.populate(range(shape.vehicles))
    until(lambda: know(network.nodes, shape.vehicles), "every router knows every vehicle")
    form = time.monotonic() - start
    forming_cpu = network.nodes[0].ask("usage")["cpu"]
    ask_all(network.nodes, "speak")
    return measure(children, shape, network.nodes, network.ports[0], shape.vehicles, form, forming_cpu)


def _grouped(children: Children, shape: Shape) -> Run:
    """As the flat run, the ground's router being on the trunk: its neighbour is the trunk's first router."""
    port = free_port(socket.SOCK_DGRAM)
    trunk = Child(children, "trunk", NODE, {"fleet": FLEET, "listen": [endpoint(port)], "connect": []})
    trunk.hear()
    each = max(shape.routers // shape.groups, 1)
    networks = [Network(children, f"g{i}-", shape.topology, each) for i in range(shape.groups)]
    shares = [
        range(i * shape.vehicles // shape.groups, (i + 1) * shape.vehicles // shape.groups) for i in range(shape.groups)
    ]
    for network in networks:
        network.ready()
        until(network.formed, "every router has a neighbour")
    start = time.monotonic()
    for network, share in zip(networks, shares, strict=True):
        network.populate(share)
    for network, share in zip(networks, shares, strict=True):
        nodes, count = network.nodes, len(share)
        until(lambda n=nodes, c=count: know(n, c), "every router knows its group")  # type: ignore[misc]
    form = time.monotonic() - start
    gateways = [_gateway(children, i, network, port) for i, network in enumerate(networks)]
    for gateway in gateways:
        gateway.hear()
        until(lambda g=gateway: bool(g.ask("usage")["routers"]), "the gateway is on the trunk")  # type: ignore[misc]
    routers = [node for network in networks for node in network.nodes]
    ask_all(routers, "speak")  # a gateway opens a door for a vehicle when it hears it
    until(lambda: _doors(gateways) == shape.vehicles, "the gateways have heard everybody")
    forming_cpu = routers[0].ask("usage")["cpu"]
    return measure(children, shape, routers, port, 0, form, forming_cpu)


def _doors(gateways: list[Child]) -> int:
    return sum(int(answer["doors"]) for answer in ask_all(gateways, "usage"))


def _gateway(children: Children, i: int, network: Network, port: int) -> Child:
    how = {
        "fleet": FLEET,
        "group": f"g{i}",
        "inside": [network.local],
        "connect": [endpoint(port)],
        "listen": [f"tcp/127.0.0.1:{free_port()}"],
    }
    return Child(children, f"gateway{i}", GATEWAY, how)
