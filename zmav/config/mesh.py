"""The network's part of the fleet file: which radios a host has, whom it hears, and how fast a lost link is noticed.

[mesh]                          # for the whole fleet
profile = "mesh"                # lan, wds, mesh, multi or cloud

[mesh.thin]                     # over any radio with a budget, at most so often, in Hz
ATTITUDE = 4

[vehicles.quad1.mesh]           # and of one host: a vehicle here, a ground host under [stations.ground.mesh]
neighbours = ["quad2", "ground"]

[[vehicles.quad1.mesh.radios]]
interface = "wlan0"
address = "10.77.0.1"

[[vehicles.quad1.mesh.radios]]
interface = "wwan0"
kind = "lte"
address = "10.8.0.11"
budget = "60 kB/s"
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from zmav.config.table import Positive, Table

Profile = Literal["lan", "wds", "mesh", "multi", "cloud"]
RadioKind = Literal["ethernet", "wifi", "lte", "serial"]
Port = Annotated[int, msgspec.Meta(ge=1, le=65535)]


class Radio(Table, frozen=True):
    """One way out of a host: a network interface and what may go through it."""

    interface: str | None = None
    """``wlan0``, ``bat0``, ``wwan0``; None: whichever has the address"""
    address: str | None = None
    """the host's own IP address there; None: read from the interface when the router starts"""
    kind: RadioKind = "wifi"
    port: Port | None = None
    """where its router listens; None: the fleet's"""
    cost: Annotated[int, msgspec.Meta(ge=1, le=10_000)] | None = None
    """the cheaper way is preferred; None: by kind"""
    budget: str | None = None
    """``60 kB/s`` or ``1 Mbit/s``: what may leave through it, IP headers included"""
    thin: dict[str, Positive] = {}
    """message name -> Hz at most through it"""


class Host(Table, frozen=True):
    """One host's place in the network."""

    profile: Profile | None = None
    """None: the fleet's"""
    radios: list[Radio] = []
    neighbours: list[str] | None = None
    """names of the fleet's other hosts, or Zenoh endpoints; None: by the profile"""
    relay: bool = True
    """False: it carries nobody else's traffic, and no other host takes from it what is not its own"""


class Mesh(Table, frozen=True):
    """What the whole fleet has in common. Timers that are None are the profile's."""

    profile: Profile = "lan"
    insecure: bool = False
    """True: off loopback without credentials, for a laboratory: whoever hears the radio commands the fleet"""
    port: Port = 7447
    rendezvous: list[str] = []
    """``cloud``: endpoints of the routers that everybody reaches"""
    thin: dict[str, Positive] = {}
    """message name -> Hz at most, through radios that have a budget"""
    lease: Positive | None = None
    """s without a word after which a neighbour is lost"""
    keep_alive: Annotated[int, msgspec.Meta(ge=2, le=20)] | None = None
    """words within a lease"""
    retry: Positive | None = None
    """s between attempts to reach a neighbour, at most"""
