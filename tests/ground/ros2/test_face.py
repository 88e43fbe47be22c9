"""Who has a node and who has none, without an autopilot behind."""

from __future__ import annotations

import asyncio
import contextlib
import time
from typing import TYPE_CHECKING, Any

import pytest
import zenoh

import zmav
from ground.ros2 import graph
from ground.ros2.cli import may_order
from ground.ros2.face import LOOK, Face
from ground.ros2.telemetry import STATE_TOPICS, TOPICS
from ground.ros2.types import known
from tests.trust.conftest import Authority, authority  # noqa: F401  (a fixture)
from tests.waiting import until
from zmav import keys, wire
from zmav.tokens import find_tokens
from zmav.waiting import in_thread

if TYPE_CHECKING:
    from tests.conftest import Net

TRIGGER = "std_srvs/srv/Trigger"


def speak(session: zenoh.Session, name: str, fleet: str = "demo", autopilot: str | None = "px4") -> None:
    state = wire.VehicleState(
        t=time.time(), fleet=fleet, name=name, instance=name, sysid=1, compid=1, autopilot=autopilot, connected=True
    )
    session.put(keys.STATE.key(fleet, name), wire.encode(state), encoding=keys.JSON)


async def test_twenty_vehicles_have_twenty_namespaces(net: Net) -> None:
    session, endpoint = net.router()
    names = [f"quad{number}" for number in range(1, 21)]
    async with zmav.open(connect=[endpoint]) as z, Face(z, 0, {}, print, may_order=False) as face:

        def there() -> bool:
            for name in names:
                speak(session, name)
            return len(face.vehicles) == 20

        await until(there)
        tokens = await in_thread(find_tokens, session, f"{graph.SPACE}/0/**", 5.0)
        found = [each for each in map(graph.parse, tokens) if each is not None]
        topics = [each.name for each in found if each.kind == graph.PUBLISHER and each.name.startswith("/quad")]
        assert len(topics) == len(set(topics))
        own = [name for name in (*TOPICS, *(each[0] for each in STATE_TOPICS)) if not name.startswith("/")]
        assert {f"/{name}/{topic}" for name in names for topic in own} <= set(topics)
        assert len({each.gid for each in found}) == len(found)
        services = [each.name for each in found if each.kind == graph.SERVER]
        assert len(services) == len(set(services))
    assert await in_thread(find_tokens, session, f"{graph.SPACE}/0/**", 5.0) == [], "nothing is left behind"


async def test_another_definition_of_a_type_is_said(net: Net) -> None:
    session, endpoint = net.router()
    said: list[str] = []
    async with zmav.open(connect=[endpoint]) as z, Face(z, 0, {}, said.append, may_order=False) as face:
        node = graph.Node(0, str(session.info.zid()), 1, "/quad1", "else\x1b[2J")
        other = graph.Endpoint(node, 3, graph.SERVER, "/quad1/land", TRIGGER, "RIHS01_\x1b[2J")
        token = session.liveliness().declare_token(other.token)

        def told() -> bool:
            speak(session, "quad1")
            return bool(face.vehicles) and len(said) == 1

        await until(told)
        assert "another definition of std_srvs/srv/Trigger" in said[0]
        assert said[0].isprintable(), "whatever others call themselves"
        token.undeclare()


async def services(session: zenoh.Session, name: str) -> list[str]:
    """The sessions that serve it."""
    tokens = await in_thread(find_tokens, session, f"{graph.SPACE}/0/**", 5.0)
    found = [each for each in map(graph.parse, tokens) if each is not None]
    return [each.node.zid for each in found if each.kind == graph.SERVER and each.name == name]


async def test_of_two_one_speaks_for_a_vehicle_and_the_other_takes_over(net: Net) -> None:
    session, endpoint = net.router()
    said: list[str] = []
    async with contextlib.AsyncExitStack() as stack, zmav.open(connect=[endpoint]) as other:
        z = await stack.enter_async_context(zmav.open(connect=[endpoint]))
        face = await stack.enter_async_context(Face(z, 0, {}, print, may_order=False))

        def there() -> bool:
            speak(session, "quad1")
            return "quad1" in face.vehicles and face.swarm is not None

        await until(there)
        async with Face(other, 0, {}, said.append, may_order=False) as second:

            def told() -> bool:
                speak(session, "quad1")
                return len(said) == 2

            await until(told)
            assert not second.vehicles
            assert second.swarm is None
            assert any("another 'zmav ros2' shows /quad1/zmav: this one stands by" in line for line in said)
            assert any("shows /demo/swarm" in line for line in said)
            for name in ("/quad1/hold", "/demo/swarm/goto/_action/send_goal"):
                assert await services(session, name) == [str(z.session.info.zid())]
            await stack.aclose()

            def taken() -> bool:
                speak(session, "quad1")
                return "quad1" in second.vehicles and second.swarm is not None

            await until(taken)
            assert "/quad1/zmav is shown here" in said
            assert await services(session, "/quad1/hold") == [str(other.session.info.zid())]


async def test_of_two_that_came_at_a_time_the_lower_session_goes_on(net: Net) -> None:
    """As when a network that was torn is whole again: each had shown it."""
    session, endpoint = net.router()
    async with zmav.open(connect=[endpoint]) as z, Face(z, 0, {}, print, may_order=False) as face:
        own = str(z.session.info.zid())

        def there() -> bool:
            speak(session, "quad1")
            return "quad1" in face.vehicles

        await until(there)
        listener = graph.Node(0, "0", 1, "/quad1", "zmav")
        heard = graph.Endpoint(listener, 2, graph.SUBSCRIBER, "/quad1/hold", TRIGGER, known().hash(TRIGGER))
        shown = session.liveliness().declare_token(heard.token)
        await until(lambda: bool(face.watch.who(heard.gid)))
        await asyncio.sleep(5 * LOOK)
        assert "quad1" in face.vehicles, "who only listens, as a viewer's node may, keeps nobody away"
        shown.undeclare()
        for zid, stays in (("f" * 33, True), ("0", False)):
            node = graph.Node(0, zid, 1, "/quad1", "zmav")
            assert (zid > own) is stays
            end = graph.Endpoint(node, 2, graph.SERVER, "/quad1/hold", TRIGGER, known().hash(TRIGGER))
            token = session.liveliness().declare_token(end.token)
            await until(lambda: bool(face.watch.sessions_of("/quad1/zmav")))
            await asyncio.sleep(5 * LOOK)
            assert ("quad1" in face.vehicles) is stays
            token.undeclare()
            await until(lambda: not face.watch.sessions_of("/quad1/zmav"))
            await until(there)


async def test_one_that_is_beside_a_vehicle_shows_no_other(net: Net) -> None:
    session, endpoint = net.router()
    async with zmav.open(connect=[endpoint]) as z, Face(z, 0, {}, print, may_order=False, only="quad-1") as face:

        def there() -> bool:
            speak(session, "quad2")
            speak(session, "quad-1")
            return bool(face.vehicles)

        await until(there)
        await asyncio.sleep(5 * LOOK)
        assert list(face.vehicles) == ["quad_1"]
        assert face.swarm is None


class Emptied:
    """A client that forgets at once who is ``gone``: not only after half a minute."""

    def __init__(self, z: zmav.Client) -> None:
        self._z, self.gone = z, set[str]()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._z, name)

    def fleet(self) -> list[zmav.Vehicle]:
        return [vehicle for vehicle in self._z.fleet() if vehicle.name not in self.gone]


async def test_two_names_that_ros_cannot_tell_apart_are_said(net: Net) -> None:
    session, endpoint = net.router()
    said: list[str] = []
    async with zmav.open(connect=[endpoint]) as z, Face(z, 0, {}, said.append, may_order=False) as face:

        def told() -> bool:
            speak(session, "quad-1")
            speak(session, "quad_1")
            return bool(said)

        await until(told)
        assert list(face.vehicles) == ["quad_1"]
        assert "is left out: in ROS it would be /quad_1" in said[0]


async def test_a_name_in_ros_stays_its_vehicles(net: Net) -> None:
    """Who of ROS commands /quad_1 must not find another vehicle there."""
    session, endpoint = net.router()
    said: list[str] = []
    async with zmav.open(connect=[endpoint]) as z:
        seen: Any = Emptied(z)
        async with Face(seen, 0, {}, said.append, may_order=False) as face:

            def told() -> bool:
                speak(session, "quad-1")
                speak(session, "quad_1")
                return bool(said)

            await until(told)
            seen.gone.add("quad-1")
            await until(lambda: not face.vehicles)
            await asyncio.sleep(5 * LOOK)
            assert not face.vehicles
            seen.gone.clear()
            await until(lambda: list(face.vehicles) == ["quad_1"])
            assert face.vehicles["quad_1"].vehicle.name == "quad-1"


class Spoilt:
    """In a node's place: each look at it is counted, and fails."""

    def __init__(self, node: Any) -> None:
        self.vehicle, self.close, self.looked = node.vehicle, node.close, 0

    def look(self, now: float) -> None:
        self.looked += 1
        raise ValueError("nothing can be told of it")


async def test_a_state_that_cannot_be_told_keeps_no_other_back(net: Net) -> None:
    session, endpoint = net.router()
    async with zmav.open(connect=[endpoint]) as z, Face(z, 0, {}, print, may_order=False) as face:

        def there() -> bool:
            speak(session, "quad1")
            speak(session, "quad2")
            return len(face.vehicles) == 2

        await until(there)
        nodes: dict[str, Any] = face.vehicles
        for name in list(nodes):
            nodes[name] = Spoilt(nodes[name])
        await until(lambda: all(node.looked > 2 for node in nodes.values()))


async def test_what_it_feels_is_asked_for_once_its_autopilot_is_known(net: Net) -> None:
    session, endpoint = net.router()
    async with zmav.open(connect=[endpoint]) as z, Face(z, 0, {}, print, may_order=False) as face:

        def there() -> bool:
            speak(session, "quad1", autopilot=None)
            return "quad1" in face.vehicles

        await until(there)
        node = graph.Node(0, str(session.info.zid()), 1, "/", "reader")
        kind = TOPICS["imu/data"].type
        end = graph.Endpoint(node, 2, graph.SUBSCRIBER, "/quad1/imu/data", kind, known().hash(kind))
        token = session.liveliness().declare_token(end.token)
        telemetry = face.vehicles["quad1"].telemetry
        await until(lambda: telemetry.wanted == ["imu/data"])

        async def wanted() -> set[str]:
            found = await in_thread(find_tokens, session, "zmav/demo/quad1/**", 5.0)
            return {message for message in ("RAW_IMU", "HIGHRES_IMU") if any(message in each for each in found)}

        assert await wanted() == {"RAW_IMU"}
        deadline = time.monotonic() + 30.0
        while await wanted() != {"HIGHRES_IMU"}:
            assert time.monotonic() < deadline, await wanted()
            speak(session, "quad1")
        assert telemetry.wanted == ["imu/data"]
        token.undeclare()
        await until(lambda: not telemetry.wanted)


async def test_who_is_gone_has_no_node(net: Net) -> None:
    session, endpoint = net.router()
    async with zmav.open(connect=[endpoint]) as z:
        seen: Any = Emptied(z)
        await _comes_and_goes(session, seen)


async def _comes_and_goes(session: zenoh.Session, seen: Any) -> None:
    async with Face(seen, 3, {}, print, may_order=False) as face:

        def there() -> bool:
            speak(session, "quad1")
            return "quad1" in face.vehicles

        await until(there)
        assert await in_thread(find_tokens, session, f"{graph.SPACE}/3/*/*/*/*/*/%quad1/**", 5.0)
        seen.gone.add("quad1")
        await until(lambda: not face.vehicles)
        deadline = time.monotonic() + 30.0
        while await in_thread(find_tokens, session, f"{graph.SPACE}/3/*/*/*/*/*/%quad1/**", 5.0):
            assert time.monotonic() < deadline, "its tokens are left behind"


@pytest.mark.parametrize(("role", "orders"), [("viewer", False), ("planner", True), ("operator", True)])
async def test_a_viewers_credentials_give_no_orders(
    net: Net,
    authority: Authority,  # noqa: F811
    role: str,
    orders: bool,
    capsys: pytest.CaptureFixture[str],
) -> None:
    _, endpoint = net.router()
    async with zmav.open(connect=[endpoint], credentials=str(authority.issue("alice", role))) as z:
        assert may_order(z) is orders
    assert ("no orders, by your credentials" in capsys.readouterr().err) is not orders


async def test_recordings_take_no_orders(net: Net, capsys: pytest.CaptureFixture[str]) -> None:
    _, endpoint = net.router()
    async with zmav.open(connect=[endpoint], fleet="demo-replay") as z:
        assert not may_order(z)
    assert "recordings" in capsys.readouterr().err
