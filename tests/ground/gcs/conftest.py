"""A fleet without autopilots, whose frames a test makes to the last byte, a bridge before it, and stations."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
import time
from collections.abc import AsyncIterator, Callable
from typing import TYPE_CHECKING, Any

import pytest
import zenoh

import zmav
from ground.gcs.bridge import Bridge, BridgeSettings
from ground.gcs.options import Options, parse_endpoint
from ground.gcs.tcp import TcpIn
from ground.gcs.udp import UdpIn
from tests.waiting import until
from zmav import keys, wire
from zmav.mavlink import Dialect, Frame, Packer, Splitter, decode, encode, load_dialect

if TYPE_CHECKING:
    from tests.conftest import Net

PATIENCE_S = 30.0
FLEET = "demo"


class Craft:
    """A vehicle on the key space: its token, its state, its frames; ``told`` is what was put for its autopilot."""

    def __init__(self, session: zenoh.Session, name: str, sysid: int, uid: str = "") -> None:
        self.session, self.name, self.sysid = session, name, sysid
        self.uid = uid or name
        self.dialect: Dialect = load_dialect()
        self.packer = Packer(self.dialect, sysid, 1)
        self._changed = threading.Condition()
        self.told: list[tuple[str, bytes]] = []
        self._subscriber = session.declare_subscriber(
            keys.TX.key(FLEET, name, sys="*", comp="*", msg="*"), self._on_told
        )
        self._token = session.liveliness().declare_token(
            keys.ALIVE.key(
                FLEET, name, role=keys.VEHICLE, sys=sysid, autopilot="ardupilot", uid=self.uid, instance=name
            )
        )

    def _on_told(self, sample: zenoh.Sample) -> None:
        with self._changed:
            self.told.append((str(sample.key_expr), sample.payload.to_bytes()))
            self._changed.notify_all()

    def publish_state(self) -> None:
        state = wire.VehicleState(
            t=time.time(),
            fleet=FLEET,
            name=self.name,
            instance=self.name,
            sysid=self.sysid,
            compid=1,
            uid=self.uid,
            kind="copter",
            autopilot="ardupilot",
            connected=True,
        )
        self.session.put(keys.STATE.key(FLEET, self.name), wire.encode(state), encoding=keys.JSON)

    def leave(self) -> None:
        self._token.undeclare()
        self._subscriber.undeclare()

    def says(self, message: str, /, **fields: Any) -> bytes:
        """Put the next frame of its autopilot on the key space; the frame."""
        data = self.packer.pack(message, **fields)
        self.puts(data)
        return data

    def puts(self, data: bytes, *, sysid: int | None = None, compid: int = 1) -> None:
        """A frame, or anything, under the key of one."""
        msgid = int.from_bytes(data[7:10], "little") if data[:1] == b"\xfd" else data[5] if len(data) > 5 else 0
        name = self.dialect.name_of(msgid)
        key = keys.RX.key(FLEET, self.name, sys=self.sysid if sysid is None else sysid, comp=compid, msg=name)
        self.session.put(key, data, **{**keys.RX.qos.options(), "congestion_control": zenoh.CongestionControl.BLOCK})

    def event(self, kind: str, severity: wire.Severity, text: str) -> None:
        body = wire.Event(t=time.time(), kind=kind, severity=severity, text=text)
        self.session.put(keys.EVENT.key(FLEET, self.name), wire.encode(body), encoding=keys.JSON)

    async def hears(self, true: Callable[[str, bytes], bool], what: str) -> bytes:
        """The first frame for its autopilot of which it holds."""

        def wait() -> list[bytes]:
            with self._changed:
                found: list[bytes] = []

                def there() -> bool:
                    found[:] = [data for key, data in self.told if true(key, data)][:1]
                    return bool(found)

                self._changed.wait_for(there, PATIENCE_S)
                return found

        found = await asyncio.to_thread(wait)
        assert found, f"{self.name} was never told {what}: {self.told[-5:]}"
        return found[0]


class Station:
    """A ground control station: a socket, and every frame that came on it."""

    def __init__(self, sock: socket.socket, sysid: int = 255, compid: int = 190) -> None:
        self.sock, self.sysid = sock, sysid
        self.dialect = load_dialect()
        self.packer = Packer(self.dialect, sysid, compid)
        self.splitter = Splitter(self.dialect)
        self.frames: list[Frame] = []
        self._named: dict[str, list[Frame]] = {}
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        with contextlib.suppress(OSError):
            while data := self.sock.recv(65535):
                with self._changed:
                    for frame in self.splitter.feed(data):
                        self.frames.append(frame)
                        self._named.setdefault(self.dialect.name_of(frame.msgid), []).append(frame)
                    self._changed.notify_all()

    def send(self, message: str, /, **fields: Any) -> bytes:
        data = self.packer.pack(message, **fields)
        self.sock.sendall(data)
        return data

    def beat(self) -> bytes:
        return self.send("HEARTBEAT", type=6, autopilot=8, system_status=4)

    def named(self, name: str) -> list[Frame]:
        return list(self._named.get(name, ()))

    def texts(self) -> str:
        """Every STATUSTEXT so far, put together."""
        return "".join(str(decode(frame, self.dialect)["text"]) for frame in self.named("STATUSTEXT"))

    def wait_for(self, true: Callable[[], bool]) -> bool:
        """Wait until it holds; it is asked again whenever something came."""
        with self._changed:
            return self._changed.wait_for(true, PATIENCE_S)

    async def until(self, true: Callable[[], bool], what: str) -> None:
        """As :meth:`wait_for`, beside an event loop."""
        got = [self.dialect.name_of(frame.msgid) for frame in self.frames[-8:]]
        assert await asyncio.to_thread(self.wait_for, true), f"never: {what}; last came {got}, {self.texts()}"

    async def gets(self, data: bytes) -> None:
        """Wait for exactly these bytes."""
        await self.until(lambda: any(frame.data == data for frame in self.frames), f"frame {data.hex()}")

    def lost(self) -> int:
        """Frames that are missing by their sequence numbers."""
        return self.splitter.counters.lost

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self.sock.shutdown(socket.SHUT_RDWR)
        self.sock.close()


class Scene:
    """A router, the fleet in it, a bridge that is its client, and what the bridge said on the terminal."""

    def __init__(self, net: Net, stack: contextlib.AsyncExitStack) -> None:
        self._stack = stack
        self.net = net
        self.router, self.router_endpoint = net.router()
        self.crafts: list[Craft] = []
        self.said: list[str] = []

    def craft(self, name: str, sysid: int, uid: str = "") -> Craft:
        self.crafts.append(Craft(self.router, name, sysid, uid))
        return self.crafts[-1]

    async def bridge(
        self, tcp: str = "", udpin: str = "", *, udp: int = 0, vehicles: str = "*", streams: bool = False
    ) -> Bridge:
        """One with a TCP and a UDP server on free ports; ``tcp`` and ``udpin`` are their options."""
        z = await self._stack.enter_async_context(zmav.open(connect=[self.router_endpoint]))
        ends = [
            parse_endpoint("tcp", f"0?{tcp}", Options()),
            parse_endpoint("udpin", f"0?{udpin}", Options()),
        ]
        if udp:
            ends.append(parse_endpoint("udp", str(udp), Options()))
        await self.known(z)
        settings = BridgeSettings(endpoints=tuple(ends), vehicles=tuple(vehicles.split(",")), streams=streams)
        bridge = await self._stack.enter_async_context(Bridge(z, settings, self.said.append))
        await self.net.linked(self.router, keys.RX.key(FLEET, "*", sys="*", comp="*", msg="*"))
        return bridge

    async def known(self, z: zmav.Client) -> None:
        """Wait until every craft's state was heard."""
        deadline = time.monotonic() + PATIENCE_S
        while missing := [craft for craft in self.crafts if z.heard(craft.name, FLEET) is None]:
            assert time.monotonic() < deadline, f"never heard: {[craft.name for craft in missing]}"
            for craft in missing:
                craft.publish_state()
            await z.news(0.05)

    async def tcp(self, bridge: Bridge, sysid: int = 255, compid: int = 190) -> Station:
        """A station on the bridge's TCP server, which it has spoken to."""
        (end,) = (each for each in bridge.endpoints if isinstance(each, TcpIn))
        before = len(bridge.clients)
        sock = await asyncio.to_thread(socket.create_connection, end.address[:2])
        return await self._greet(bridge, before, sock, sysid, compid)

    async def udp(self, bridge: Bridge, sysid: int = 255, compid: int = 190) -> Station:
        """A station on the bridge's UDP server, which it has spoken to."""
        (end,) = (each for each in bridge.endpoints if isinstance(each, UdpIn))
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sock.connect(end.address)
        return await self._greet(bridge, len(bridge.clients), sock, sysid, compid)

    async def _greet(self, bridge: Bridge, before: int, sock: socket.socket, sysid: int, compid: int) -> Station:
        station = Station(sock, sysid, compid)
        self._stack.callback(station.close)
        station.beat()
        taken = any(craft.sysid == sysid for craft in self.crafts)
        await until(
            lambda: len(bridge.clients) > before and (taken or bool(bridge.clients[-1].ids)),
            "the bridge knows a station",
        )
        return station

    async def heard(self, what: str) -> None:
        """Wait for a line on the terminal that holds this."""
        await until(lambda: any(what in line for line in self.said), f"{what!r} among {self.said}")


@pytest.fixture
async def scene(net: Net) -> AsyncIterator[Scene]:
    async with contextlib.AsyncExitStack() as stack:
        yield Scene(net, stack)


def command(craft: Craft, number: int, **params: float) -> dict[str, Any]:
    """The fields of a COMMAND_LONG for a craft's autopilot."""
    return {"target_system": craft.sysid, "target_component": 1, "command": number, **params}


def unknown_frame(sysid: int, compid: int, seq: int = 0) -> bytes:
    """A frame whose message no dialect has: a HEARTBEAT with another number."""
    beat = encode(
        load_dialect(),
        "HEARTBEAT",
        {"type": 6, "autopilot": 8, "base_mode": 0, "custom_mode": 0, "system_status": 4},
        sysid=sysid,
        compid=compid,
        seq=seq,
    )
    return beat[:7] + (0xFFEEDD).to_bytes(3, "little") + beat[10:]
