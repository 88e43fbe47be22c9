"""The recorder on the key space: hears what the registry says is recorded, says how it does, answers what was."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import re
import socket
import time
from collections.abc import Callable, Sequence
from typing import Any

import msgspec
import zenoh

from ground.feed import apart, patterns
from ground.host import host_name
from ground.record.folder import Folder
from ground.record.history import Answers
from ground.record.storage import RecordingSettings, Storage
from ground.record.video import VideoFiles
from zmav import keys, wire
from zmav.cli.common import size
from zmav.client import Client
from zmav.trust.certificate import Role
from zmav.vehicle.rates import want_key
from zmav.waiting import cancelled, in_thread

AGENT = "recorder"
STATUS_S = 1.0
FRAMES = "mav/"
BELIEVED = ("state", "event")


class Wanted(msgspec.Struct, frozen=True, kw_only=True):
    """What to record, and as whom."""

    vehicles: tuple[str, ...] = ("*",)
    rates: dict[str, float] = {}
    """Hz by message: what the autopilots are to send for the recording's sake"""
    video: bool = False
    """of their cameras, in files beside"""
    name: str | None = None
    """of the host; None: the credentials' or the machine's"""


class Recorder:
    """``async with Recorder(client, folder, settings, wanted, tell): ...``; ``tell``: a line for anyone who watches.

    Raises :class:`~zmav.errors.BadConfig` and :class:`~zmav.errors.BadKey` on entry.
    """

    def __init__(
        self, z: Client, folder: Folder, settings: RecordingSettings, wanted: Wanted, tell: Callable[[str], None]
    ) -> None:
        self._z, self._folder, self._wanted, self._tell = z, folder, wanted, tell
        self._fleet = z.fleet_name
        self.name = host_name(z, wanted.name or "", _host())
        self.storage = Storage(folder, settings, z.dialect, tell)
        self.video: VideoFiles | None = None
        self._answers: Answers | None = None
        self._held: list[Any] = []
        self._tasks: list[asyncio.Task[None]] = []

    async def __aenter__(self) -> Recorder:
        try:
            await self._begin()
        except BaseException:
            await self.close()
            raise
        return self

    async def _begin(self) -> None:
        session, instance = self._z.session, str(self._z.session.info.zid())
        self.storage.start()
        self._subscribe(patterns(self._wanted.vehicles))
        shared = [channel.key(self._fleet, topic="*", group="*", name="*") for channel in shared_channels()]
        for key in apart(shared):  # some of the fleet's topics are channels of their own
            self._held.append(session.declare_subscriber(str(key), functools.partial(self._take, ())))
        self._answers = Answers(session, self.storage.history, self._fleet, self.name)
        self._held.append(session.liveliness().declare_token(self._token(instance)))
        self._tasks.append(asyncio.create_task(self._say_status()))
        if self._wanted.video:
            storage, own = self.storage, self._wanted
            self.video = VideoFiles(self._z, storage.session, own.vehicles, lambda: not storage.paused, self._tell)
            await self.video.__aenter__()

    async def __aexit__(self, *exception: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Hear no more, write what came, complete the files; twice is harmless."""
        video, self.video = self.video, None
        if video is not None:
            await video.__aexit__()
        tasks, self._tasks = self._tasks, []
        await cancelled(*tasks)
        answers, self._answers = self._answers, None
        if answers is not None:
            await in_thread(answers.close)
        while self._held:
            with contextlib.suppress(zenoh.ZError):
                self._held.pop().undeclare()
        await in_thread(self.storage.close)

    def _subscribe(self, vehicles: list[str]) -> None:
        """To all that is recorded of these vehicles, once each where two patterns name one."""
        for rest in vehicle_channels():
            wanted = apart(keys.expression(f"{vehicle}/{rest}", self._fleet) for vehicle in vehicles)
            for number, key in enumerate(wanted):
                take = functools.partial(self._take, wanted[:number])
                if rest in BELIEVED:  # with credentials, what their vehicle did not sign is left out
                    self._tasks.append(asyncio.create_task(self._believe(str(key), take)))
                else:
                    self._held.append(self._z.session.declare_subscriber(str(key), take))
        for vehicle in vehicles:
            for message, hz in self._wanted.rates.items():
                frames = keys.expression(f"{vehicle}/mav/rx/*/*/{keys.check_message(message)}", self._fleet)
                self._held.append(self._z.session.liveliness().declare_token(want_key(frames, hz, AGENT)))

    async def _believe(self, key: str, take: Callable[[zenoh.Sample], None]) -> None:
        async with self._z.subscribe(key) as samples:
            async for sample in samples:
                take(sample)

    def _take(self, earlier: Sequence[zenoh.KeyExpr], sample: zenoh.Sample) -> None:
        """``earlier``: the expressions of the other subscribers, to whom what they bring is left."""
        key = str(sample.key_expr)
        if any(expression.intersects(sample.key_expr) for expression in earlier):
            return
        heard = keys.hears(f"{keys.ROOT}/{self._fleet}", key)
        if sample.kind == zenoh.SampleKind.PUT and heard and self._is_worth_it(key):
            self.storage.put(key, sample.payload.to_bytes())

    def _is_worth_it(self, key: str) -> bool:
        """Not rosters, which every certificate may put, and not what only vehicles say, in another's name."""
        _, fleet, name, rest = key.split("/", 3)
        if name == "@fleet":
            return rest != keys.ROSTER
        return not rest.startswith(FRAMES) or self._z.is_vehicle(fleet, name)

    def _token(self, instance: str) -> str:
        role = self._z.member.credentials.role.value if self._z.member else Role.VIEWER.value
        return keys.ALIVE.key(self._home, self.name, role=role, sys=0, autopilot=AGENT, uid="-", instance=instance)

    @property
    def _home(self) -> str:
        """The fleet in which the recorder itself is."""
        return self._fleet if self._fleet != "*" else "demo"

    async def _say_status(self) -> None:
        key = keys.AGENT_STATUS.key(self._home, self.name, agent=AGENT)
        while True:
            self._z.put(keys.AGENT_STATUS, key, self.status())
            await asyncio.sleep(STATUS_S)

    def status(self) -> wire.AgentStatus:
        storage, counts = self.storage, self.storage.counts
        paused = storage.paused
        text = paused or f"{counts.written} samples in {size(counts.bytes)}"
        if counts.dropped:
            text += f"; {counts.dropped} dropped: this machine is too slow"
        detail = {**msgspec.structs.asdict(counts), "session": str(storage.session)}
        with contextlib.suppress(OSError):  # the folder was taken away
            detail["free"] = self._folder.free()
        state = "paused" if paused else "recording"
        return wire.AgentStatus(t=time.time(), agent=AGENT, state=state, text=text, detail=detail)


def vehicle_channels() -> list[str]:
    """What is recorded of each vehicle, as key expressions below it. Orders go to it alone, and nobody hears them."""
    own = "{fleet}/{vehicle}/"
    return [
        re.sub(r"{\w+}", "*", channel.template.removeprefix(own))
        for channel in keys.CHANNELS.values()
        if channel.recorded and channel.kind in ("pub", "put") and channel.template.startswith(own)
    ]


def shared_channels() -> list[keys.Channel]:
    """What is recorded and is nobody's own."""
    found = [channel for channel in keys.CHANNELS.values() if channel.recorded and channel.kind in ("pub", "put")]
    return [channel for channel in found if "{vehicle}" not in channel.template]


def _host() -> str:
    """This machine's name, as it can stand in a key."""
    return re.sub(r"[^a-z0-9_-]+", "-", socket.gethostname().partition(".")[0].lower()).strip("-") or "ground"
