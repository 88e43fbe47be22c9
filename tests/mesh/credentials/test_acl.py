"""What each role gets through a router's door, tried on every channel and every verb of the registry."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import pytest
import zenoh

import zmav
from tests.waiting import wait_until
from zmav import keys
from zmav.config import FleetConfig, Host, StationConfig, VehicleConfig
from zmav.errors import Forbidden
from zmav.keys import CHANNELS
from zmav.session import SessionSettings
from zmav.trust.certificate import Role
from zmav.verbs import SWARM_VERBS, VERBS

if TYPE_CHECKING:
    from tests.mesh.credentials.conftest import Door, Fleet, Home

MEMBERS = {"quad2": Role.VEHICLE, "ops": Role.OPERATOR, "plan": Role.PLANNER, "view": Role.VIEWER}
"""quad1 is the one whose door it is"""
RELAYS = ("quad2", "ops")
PATIENCE_S = 30.0
ANYBODYS = "camera/x1/report"
"""under whose own name ever, everybody may put here"""


def every_key(vehicle: str) -> Iterator[tuple[str, str, tuple[str, ...]]]:
    """(kind, key, who may put or ask it) of every channel, verb and topic, about one vehicle."""
    for channel in CHANNELS.values():
        names = [chunk.strip("{}") for chunk in channel.template.split("/")[1:] if chunk.startswith("{")]
        parts = {**dict.fromkeys(names, "x1"), "vehicle": vehicle}
        if channel in (keys.DO, keys.SWARM):
            for verb in (VERBS if channel is keys.DO else SWARM_VERBS).values():
                yield channel.kind, channel.key("alpha", **{**parts, "verb": verb.name}), verb.writers
        elif channel is keys.FLEET:
            for topic, writers in keys.TOPICS.items():
                yield channel.kind, channel.key("alpha", **{**parts, "topic": topic}), writers
        elif channel is keys.ALIVE:
            yield channel.kind, channel.key("alpha", **{**parts, "role": "vehicle"}), (keys.VEHICLE,)
        else:
            yield channel.kind, channel.key("alpha", **parts), channel.writers


@pytest.fixture
def door(fleet: Fleet) -> Door:
    fleet.issue(quad1=Role.VEHICLE, quad3=Role.VEHICLE, **MEMBERS)
    return fleet.router("quad1")


@pytest.fixture
def home(fleet: Fleet, door: Door) -> Home:
    return fleet.home(door)


def reached(session: zenoh.Session, key: str) -> None:
    """Wait until another session's subscriber of the key is known."""
    known = threading.Event()

    def on_match(status: Any) -> None:
        if status.matching:
            known.set()

    publisher = session.declare_publisher(key, allowed_destination=zenoh.Locality.REMOTE)
    listener = publisher.declare_matching_listener(on_match)
    status: Any = publisher.matching_status
    assert status.matching or known.wait(PATIENCE_S)
    listener.undeclare()
    publisher.undeclare()


def meet(name: str, session: zenoh.Session, home: Home) -> None:
    """Wait until what the neighbour says under its own name is heard at home: both know each other's wishes."""
    hello = f"zmav/alpha/{name}/{ANYBODYS}/hello"
    reached(session, hello)
    session.put(hello, b"", congestion_control=zenoh.CongestionControl.BLOCK)
    home.put.until(hello)


def put_all(name: str, session: zenoh.Session, home: Home, wanted: list[str]) -> set[str]:
    """Which of the keys get through; the last word is one that does."""
    last = f"zmav/alpha/{name}/{ANYBODYS}/end"
    for key in (*wanted, last):
        session.put(key, b"x", congestion_control=zenoh.CongestionControl.BLOCK)
    return home.put.until(last)


def ask_all(session: zenoh.Session, home: Home, wanted: list[str]) -> set[str]:
    last = "zmav/alpha/quad1/msg/END"
    for key in (*wanted, last):
        session.get(key, lambda reply: None, timeout=5.0)
    return home.asked.until(last)


def declare_all(name: str, session: zenoh.Session, home: Home, wanted: list[str]) -> set[str]:
    last = f"zmav/alpha/{name}/alive/router/0/-/-/end"
    held = [session.liveliness().declare_token(key) for key in (*wanted, last)]
    try:
        return home.tokens.until(last)
    finally:
        for token in held:
            token.undeclare()


def allowed(name: str, writers: tuple[str, ...]) -> bool:
    """As the originator; a relay brings what any other host may say."""
    roles = {role.value for role in Role if role is not Role.VEHICLE} if name in RELAYS else {MEMBERS[name].value}
    return bool({*roles, keys.ANYONE} & set(writers))


@pytest.mark.parametrize("protocol", ["tls", "quic"])
@pytest.mark.parametrize("name", MEMBERS)
def test_the_table_of_rights(fleet: Fleet, door: Door, home: Home, name: str, protocol: str) -> None:
    """Of quad1, at quad1's own door: what only quad1 says comes from nobody, the rest from who may."""
    session = fleet.open(name, getattr(door, protocol))
    meet(name, session, home)
    table = list(every_key("quad1"))
    for kinds, tried in ((("put", "pub"), put_all), (("token",), declare_all)):
        rows = [(key, writers) for kind, key, writers in table if kind in kinds]
        assert rows
        through = tried(name, session, home, [key for key, _ in rows])
        expected = {key for key, writers in rows if allowed(name, writers) or (name in RELAYS and "/@" in key)}
        assert through == expected
    asked = [(key, name in RELAYS or kind == "pub" or allowed(name, w)) for kind, key, w in table if kind != "put"]
    asked = [
        (key, may)
        for key, may in asked
        if "alive" not in key and "holder" not in key and "want" not in key and "slot" not in key
    ]
    assert ask_all(session, home, [key for key, _ in asked]) == {key for key, may in asked if may}


@pytest.mark.parametrize("name", MEMBERS)
def test_the_table_of_rights_under_ones_own_name(fleet: Fleet, name: str) -> None:
    """A neighbour that brings only its own brings of that what its role may: no frames where it is no vehicle."""
    fleet.issue(quad1=Role.VEHICLE, **MEMBERS)
    alone = Host(relay=False)
    file = FleetConfig(
        fleet="alpha",
        vehicles={"quad2": VehicleConfig(link="replay:x", mesh=alone)},
        stations={"ops": StationConfig(mesh=alone)},
    )
    door = fleet.router("quad1", file=file)
    home = fleet.home(door)
    session = fleet.open(name, door.quic)
    meet(name, session, home)
    role = MEMBERS[name]
    own = {keys.VEHICLE, keys.AGENT} if role is Role.VEHICLE else {role.value}
    table = list(every_key(name))
    for kinds, tried in ((("put", "pub"), put_all), (("token",), declare_all)):
        rows = [(key, writers) for kind, key, writers in table if kind in kinds]
        through = tried(name, session, home, [key for key, _ in rows])
        assert through == {key for key, writers in rows if {*own, keys.ANYONE} & set(writers)}
    says = {
        key.rpartition(f"/{name}/")[2]
        for kind, key, writers in table
        if kind == "pub" and "@" not in key and put_all(name, session, home, [key])
    }
    assert ("state" in says, "beacon" in says, "mav/rx/x1/x1/x1" in says) == (role is Role.VEHICLE,) * 3
    assert says or role is Role.VIEWER, "a viewer says nothing but what it wants and what it gets of pictures"


def test_a_vehicle_that_does_not_relay_has_its_events_recovered(fleet: Fleet) -> None:
    """Its publisher is detected, and what was missed is asked of it, although its door is narrow."""
    fleet.issue(quad1=Role.VEHICLE, quad2=Role.VEHICLE)
    table = VehicleConfig(link="replay:x", mesh=Host(relay=False))
    door = fleet.router("quad1", file=FleetConfig(fleet="alpha", vehicles={"quad2": table}))
    home, came, heard = fleet.open(None, door.local), threading.Event(), []

    def on_sample(sample: zenoh.Sample) -> None:
        heard.append(sample.payload.to_bytes())
        if len(heard) == 3:
            came.set()

    subscriber = zenoh.ext.declare_advanced_subscriber(
        home, "zmav/alpha/*/event", on_sample, history=zenoh.ext.HistoryConfig(detect_late_publishers=True)
    )
    publisher = zenoh.ext.declare_advanced_publisher(
        fleet.open("quad2", door.quic),
        "zmav/alpha/quad2/event",
        cache=zenoh.ext.CacheConfig(max_samples=10),
        publisher_detection=True,
        sample_miss_detection=zenoh.ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=1.0),
    )
    for number in range(3):
        publisher.put(str(number).encode())
    assert came.wait(PATIENCE_S)
    assert heard == [b"0", b"1", b"2"]
    subscriber.undeclare()
    publisher.undeclare()


def test_a_few_by_hand(fleet: Fleet, door: Door, home: Home) -> None:
    """The table is made from the registry; these few are not."""
    forbidden = {
        "view": ("setpoint/x", "mav/tx/1/1/HEARTBEAT", "state", "event", "mav/rx/1/1/HEARTBEAT"),
        "plan": ("mav/tx/1/1/HEARTBEAT", "state", "event", "mav/rx/1/1/HEARTBEAT"),
        "ops": ("state", "event", "mav/rx/1/1/HEARTBEAT"),
        "quad2": ("state", "event", "mav/rx/1/1/HEARTBEAT"),
    }
    for name, channels in forbidden.items():
        session = fleet.open(name, door.quic)
        meet(name, session, home)
        tried = [f"zmav/alpha/quad1/{channel}" for channel in channels]
        wild = [
            "zmav/alpha/*/state",
            "zmav/alpha/**",
            "zmav/alpha/q$*/state",
            "zmav/*/quad1/state",
            "zmav/beta/x/state",
        ]
        assert put_all(name, session, home, tried + wild) == set()
        refused = {"view": ["arm", "land", "lease", "param_set"], "plan": ["param_set", "reboot", "file_put"]}
        tried = [f"zmav/alpha/quad1/do/{verb}" for verb in refused.get(name, ())]
        assert ask_all(session, home, tried) == set()
    planner = fleet.open("plan", door.tls)
    meet("plan", planner, home)
    fine = ["zmav/alpha/quad1/do/lease", "zmav/alpha/quad1/do/goto", "zmav/alpha/quad1/do/land"]
    assert ask_all(planner, home, fine) == set(fine)
    assert put_all("plan", planner, home, ["zmav/alpha/quad1/setpoint/x"]) == {"zmav/alpha/quad1/setpoint/x"}


@pytest.mark.parametrize("name", MEMBERS)
def test_everybody_reads_and_nobody_answers_for_another(fleet: Fleet, door: Door, home: Home, name: str) -> None:
    session = fleet.open(name, door.quic)
    for key in ("zmav/alpha/quad1/do/*", "zmav/alpha/**", "zmav/alpha/*/state", f"zmav/alpha/{name}/msg/*"):
        session.declare_queryable(key, lambda query: query.reply(query.key_expr, b"hijacked"))
    heard: list[str] = []
    came = threading.Event()

    def on_sample(sample: zenoh.Sample) -> None:
        heard.append(str(sample.key_expr))
        if heard[-1].endswith("event"):
            came.set()

    session.declare_subscriber("zmav/alpha/**", on_sample)
    meet(name, session, home)
    reached(home.session, "zmav/alpha/quad1/state")
    for channel in ("state", "mav/rx/1/1/HEARTBEAT", "setpoint/x", "event"):
        home.session.put(f"zmav/alpha/quad1/{channel}", b"", congestion_control=zenoh.CongestionControl.BLOCK)
    assert came.wait(PATIENCE_S)
    assert {key for key in heard if "quad1" in key} >= {
        f"zmav/alpha/quad1/{channel}" for channel in ("state", "mav/rx/1/1/HEARTBEAT", "setpoint/x", "event")
    }
    answers = {}
    for key in ("zmav/alpha/quad1/do/arm", "zmav/alpha/quad1/state", f"zmav/alpha/{name}/msg/X"):
        replies = home.session.get(key, timeout=5.0, consolidation=zenoh.ConsolidationMode.NONE)
        answers[key] = {reply.ok.payload.to_bytes() for reply in replies if reply.ok}
    own = answers.pop(f"zmav/alpha/{name}/msg/X")
    assert b"hijacked" in own, "its own it does answer"
    assert set(map(frozenset, answers.values())) == {frozenset({b"home"})}


@pytest.mark.parametrize("relay", [True, False])
def test_who_relays_brings_others_words_and_who_does_not_brings_only_its_own(fleet: Fleet, relay: bool) -> None:
    """quad1 - quad2 - quad3, routers all, and a program beside quad3."""
    fleet.issue(**{f"quad{n}": Role.VEHICLE for n in range(1, 5)})
    table = VehicleConfig(link="replay:x", mesh=Host(relay=relay))
    file = FleetConfig(fleet="alpha", vehicles={"quad2": table})
    door = fleet.router("quad1", file=file)
    middle = fleet.router("quad2", door.quic, file=file)
    behind = fleet.router("quad3", middle.quic, file=file)
    home, half, far = fleet.home(door), fleet.home(middle), fleet.open(None, behind.unix)
    passed = relayed(far, half)
    assert passed == {"quad3/state", "quad4/state", "quad1/state", "quad1/setpoint/x"}, "but never quad2/state"
    through = put_all("quad2", half.session, home, []) - {"zmav/alpha/quad3/link/end"}
    assert through == ({f"zmav/alpha/{key}" for key in passed - {"quad1/state"}} if relay else set())


def relayed(far: zenoh.Session, half: Home) -> set[str]:
    """Which of these come as far as the middle. Routers drop what comes before they have worked out their routes."""
    says = ("quad3/state", "quad4/state", "quad2/state", "quad1/state", "quad9/state", "quad1/setpoint/x")
    last, reached_it = f"zmav/alpha/{says[-1]}", False
    for _ in range(100):
        for key in says:
            far.put(f"zmav/alpha/{key}", b"", congestion_control=zenoh.CongestionControl.BLOCK)
        if reached_it:  # once more after the first came, so that all went the same way
            break
        reached_it = half.put.comes(last, 0.1)
    far.put("zmav/alpha/quad3/link/end", b"", congestion_control=zenoh.CongestionControl.BLOCK)
    return {key.removeprefix("zmav/alpha/") for key in half.put.until("zmav/alpha/quad3/link/end")}


def test_admin_spaces_are_read_and_not_written(fleet: Fleet, door: Door, home: Home) -> None:
    viewer = fleet.open("view", door.quic)
    replies = [reply.ok for reply in viewer.get("@/*/router", timeout=5.0)]
    assert len(replies) == 1
    assert replies[0] is not None
    own = f"@/{door.session.info.zid()}/router"
    for session in (viewer, fleet.open(None, door.local)):  # these can make a router stand still for good
        assert list(session.get(f"{own}/linkstate/north", timeout=0.5)) == []
    viewer.put(f"{own}/config/access_control/enabled", b"false")
    meet("view", viewer, home)
    assert put_all("view", viewer, home, ["zmav/alpha/quad1/setpoint/x"]) == set()


def test_what_was_missed_of_an_event_is_recovered_through_the_door(fleet: Fleet, door: Door) -> None:
    """Advanced publishers' caches are asked on keys of their own."""
    home = fleet.open(None, door.local)
    publisher = zenoh.ext.declare_advanced_publisher(
        home,
        "zmav/alpha/quad1/event",
        cache=zenoh.ext.CacheConfig(max_samples=10),
        publisher_detection=True,
        sample_miss_detection=zenoh.ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=1.0),
    )
    for number in range(3):
        publisher.put(str(number).encode())
    viewer, heard = fleet.open("view", door.quic), list[bytes]()

    # A publisher's token may be here before its cache is: who asks then hears nothing, and is not told to ask again.
    cache = "zmav/alpha/quad1/event/@adv/**?_anyke"
    wait_until(lambda: any(reply.ok for reply in viewer.get(cache, timeout=1.0)), "the cache")
    deadline = time.monotonic() + PATIENCE_S
    while True:  # Zenoh loses an answer now and then: another one is asked
        came = threading.Event()

        def on_sample(sample: zenoh.Sample, came: threading.Event = came) -> None:
            heard.append(sample.payload.to_bytes())
            if len(heard) == 3:
                came.set()

        heard.clear()
        subscriber = zenoh.ext.declare_advanced_subscriber(
            viewer, "zmav/alpha/*/event", on_sample, history=zenoh.ext.HistoryConfig(detect_late_publishers=True)
        )
        if came.wait(5.0):
            break
        subscriber.undeclare()
        assert time.monotonic() < deadline, heard
    assert heard == [b"0", b"1", b"2"]
    subscriber.undeclare()
    publisher.undeclare()


def test_who_reads_more_than_the_fleet_hears_the_fleet(fleet: Fleet, door: Door, home: Home) -> None:
    """``zmav/**`` crosses a door in both directions, and brings what is the fleet's."""
    ops, heard = fleet.open("ops", door.quic), threading.Event()
    ops.declare_subscriber("zmav/**", lambda sample: heard.set(), allowed_origin=zenoh.Locality.REMOTE)
    meet("ops", ops, home)
    reached(home.session, "zmav/alpha/quad1/state")
    for key in ("zmav/beta/quad1/state", "elsewhere"):
        home.session.put(key, b"")
    ops.get("zmav/*/*/msg/X", lambda reply: None, timeout=5.0)
    home.asked.until("zmav/*/*/msg/X")
    assert not heard.is_set()
    home.session.put("zmav/alpha/quad1/state", b"")
    assert heard.wait(PATIENCE_S)


async def test_who_may_not_is_told_so_although_the_door_says_nothing(fleet: Fleet, door: Door) -> None:
    settings = SessionSettings(connect=[door.quic], credentials=str(fleet.members["view"]))
    async with zmav.open(fleet="alpha", settings=settings) as z:
        with pytest.raises(
            Forbidden, match=r"view \(viewer\) may not use do land of quad1; allowed: operator, planner"
        ):
            await z.vehicle("quad1").land()
