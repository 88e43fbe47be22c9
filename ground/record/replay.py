"""``zmav replay``: recorded flights on the key space, in step, in a fleet of their own.

No vehicle is in that fleet, and none of its keys leads to one (:func:`zmav.keys.replay_of`). So all that was recorded
can be played but what would be asked or sent there: frames for vehicles, orders, rosters.
"""

from __future__ import annotations

import asyncio
import contextlib
import heapq
import queue
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import click
import msgspec
import zenoh

import zmav
from ground.record.cli import RECORDINGS
from ground.record.folder import Record
from ground.record.sources import Source, Tlogs, open_all, readable, vehicle_of
from zmav import keys, wire
from zmav.cli.common import Between, dialect_option, fleet_option, run, zenoh_options
from zmav.client import Client
from zmav.errors import BadConfig, BadInput, Clash
from zmav.links.base import Link, LinkFinished
from zmav.onboard import Onboard, OnboardSettings
from zmav.process import say, until_stopped
from zmav.session import SessionSettings
from zmav.waiting import in_thread, until_any

LONGEST_STEP_S = 60.0
"""a longer step between two records, or one backwards, is a clock that was set, or a pause: it is played as no time"""
WAITING = 1000
"""frames that wait for a vehicle's agent, before all wait for it"""


class FedLink(Link):
    """A link whose frames are given to it; it is down for good at the end. Nothing can be sent: nobody listens."""

    recorded = True

    def __init__(self, name: str) -> None:
        super().__init__(f"replay:{name}")
        self._taken = threading.Event()
        self._frames: queue.Queue[bytes | None] = queue.Queue(WAITING)

    def feed(self, frame: bytes | None) -> None:
        """Give it a frame, or its end; waits while too many do. Once it is closed, they are nobody's."""
        while not self._closing.is_set():
            try:
                self._frames.put(frame, timeout=0.25)
                return
            except queue.Full:
                continue

    def wait_taken(self) -> None:
        """Wait until all that was given, its end included, is taken, or the link is closed."""
        while not (self._taken.wait(0.25) or self._closing.is_set()):
            pass

    def _open(self) -> str:
        return f"playing {self.url.partition(':')[2]}"

    def _read(self) -> bytes:
        try:
            frame = self._frames.get(timeout=0.25)
        except queue.Empty:
            return b""
        if frame is None:
            self._taken.set()
            raise LinkFinished("end of recording")
        return frame

    def _write(self, data: bytes) -> int:
        return 0

    def _release(self) -> None:
        pass


Deliver = Callable[[Record], None]


class Player:
    """Plays each source to its own ``deliver``, called in the player's thread.

    ``speed``: times real time, 0 for as fast as possible; ``start``: s after the earliest record. ``now`` and ``pause``
    are for tests: a clock in seconds, and a wait of so many seconds that returns True when the player is being closed.
    """

    def __init__(
        self,
        parts: Sequence[tuple[Source, Deliver]],
        speed: float = 1.0,
        loop: bool = False,
        start: float = 0.0,
        now: Callable[[], float] = time.monotonic,
        pause: Callable[[float], bool] | None = None,
    ) -> None:
        self._parts, self._speed, self._loop, self._start = list(parts), speed, loop, start
        self._stop = threading.Event()
        self._now, self._pause = now, pause or self._stop.wait
        self.played = 0
        self.error: Exception | None = None
        self.over = threading.Event()
        """all was played, or nothing more can be"""
        self._thread = threading.Thread(target=self._run, name="replay", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        self._stop.set()

    def close(self) -> None:
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join(5.0)

    def _run(self) -> None:
        try:
            while self._play() and self._loop and not self._stop.is_set():
                pass
        except Exception as e:  # a file that cannot be read any more: said by anyone who waits for the end
            self.error = e
        finally:
            self.over.set()

    def _play(self) -> bool:
        """Once; False where there is nothing to be played."""
        begin = min((first for source, _ in self._parts if (first := source.first()) is not None), default=None)
        if begin is None:
            return False
        since = begin + int(self._start * 1e9)
        last, due, before = since, self._now(), self.played
        for record, deliver in self._merged(since):
            step = (record.at - last) / 1e9
            last = record.at
            if self._speed:
                due += step / self._speed if 0.0 < step <= LONGEST_STEP_S else 0.0
                delay = due - self._now()
                if delay > 0 and self._pause(delay):
                    return False
            if self._stop.is_set():
                return False
            deliver(record)
            self.played += 1
        return self.played > before

    def _merged(self, since: int) -> Iterator[tuple[Record, Deliver]]:
        def tagged(source: Source, deliver: Deliver) -> Iterator[tuple[Record, Deliver]]:
            return ((record, deliver) for record in source.records(since))

        return heapq.merge(*(tagged(*part) for part in self._parts), key=lambda each: each[0].at)


PATIENT = "transport/link/tx/queue/congestion_control/drop/wait_before_drop:1000000"
"""1 s instead of 1 ms until a sample is dropped: at full speed the router is to be waited for"""
SETTLE_S = 1.0
"""in which a vehicle that is there is heard"""


@click.command("replay")
@click.argument("files", nargs=-1, type=click.Path(path_type=Path), metavar="[FILE]...")
@click.option("--as", "--name", "name", help="Another name; for several vehicles with a * for theirs: 'old-*'.")
@click.option("--speed", default="1", show_default=True, help="Times real time; 'max' as fast as it goes.")
@click.option("--loop", is_flag=True, help="Begin again at the end.")
@click.option("--start", type=Between(min=0.0), default=0.0, help="Seconds after the beginning to start at.")
@click.option("--sysid", type=click.IntRange(1, 255), help="Which system is the vehicle, where a .tlog has several.")
@dialect_option
@fleet_option
@zenoh_options
def command(
    files: tuple[Path, ...],
    name: str | None,
    speed: str,
    loop: bool,
    start: float,
    sysid: int | None,
    dialect: str,
    fleet: str,
    settings: SessionSettings,
) -> None:
    """Play recordings into the key space, in step: .tlog files, .mcap files, or a folder: of a session, or of the
    recorder, whose newest session is played. Without any, that of 'recordings', where 'zmav record' writes.

    They are played in a fleet of their own, 'demo-replay' for --fleet demo: no vehicle is in it, and nobody who looks
    at vehicles hears it. Look at it by that name: 'zmav ls --fleet demo-replay', 'zmav gcs --fleet demo-replay'.

    A .tlog becomes a vehicle: its frames byte for byte, and state, messages and events as in flight. Of an .mcap every
    key gets again what came on it. What is played takes no orders and no frames.
    """
    fleet = keys.replay_of(keys.check_name(fleet, "fleet"))
    sources = open_all(files or (RECORDINGS,))
    settings = msgspec.structs.replace(settings, cfg=(*settings.cfg, PATIENT))
    base = OnboardSettings(link="", name="replay", fleet=fleet, sysid=sysid, dialect=dialect)
    run(_replay(sources, name, _speed(speed), loop, start, base, settings))


async def _replay(
    sources: Sequence[Source],
    name: str | None,
    speed: float,
    loop: bool,
    start: float,
    base: OnboardSettings,
    settings: SessionSettings,
) -> None:
    async with zmav.open(fleet=base.fleet, settings=settings, dialect=base.dialect) as z:
        async with stage(z, sources, name, base) as on:
            say(f"look at it: zmav ls --fleet {base.fleet}")
            player, begun = Player(on.parts, speed, loop, start), time.monotonic()
            try:
                player.start()
                await _until_over(player, on.links)
            finally:
                for link in on.links:
                    link.close()  # what is still fed is nobody's: anyone who feeds waits no more
                await in_thread(player.close)
        _say_end(player, on.onboards, on.putter.held_back, time.monotonic() - begun)


@dataclass
class Stage:
    """What recordings are played to."""

    putter: Putter
    parts: list[tuple[Source, Deliver]] = field(default_factory=list)
    links: list[FedLink] = field(default_factory=list)
    onboards: list[Onboard] = field(default_factory=list)


@contextlib.asynccontextmanager
async def stage(z: Client, sources: Sequence[Source], name: str | None, base: OnboardSettings) -> AsyncIterator[Stage]:
    """Where each recording goes in the fleet of ``z``, which is a recording's. Raises :class:`Clash` where a vehicle is
    played there already, :class:`BadInput` and :class:`BadConfig` where there is nothing to be played.
    """
    # asked once: a file that is still written to names more vehicles later
    recorded = await asyncio.to_thread(readable, sources, say)
    names = _names(recorded, name)
    await z.settle(timeout=SETTLE_S)
    if taken := sorted(each for each in names.values() if z.present(each, base.fleet)):
        text = f"{', '.join(taken)}: played already in {base.fleet}: --as 'old-*' plays it under another name"
        raise Clash(text, vehicles=taken)
    on = Stage(Putter(z, names, name))
    async with contextlib.AsyncExitStack() as stack:
        for source, whose in recorded:
            called = [names[vehicle] for vehicle in whose]
            say(f"replaying {source.label} as {', '.join(f'{base.fleet}/{each}' for each in called)}")
            if isinstance(source, Tlogs):
                on.links.append(link := FedLink(source.label))
                on.onboards.append(Onboard(z.session, msgspec.structs.replace(base, name=called[0]), link))
                await stack.enter_async_context(on.onboards[-1])
                on.parts.append((source, _feed(link)))
            else:
                on.parts.append((source, on.putter))
        stack.callback(on.putter.close)
        yield on


def _feed(link: FedLink) -> Deliver:
    return lambda record: link.feed(record.data)


def _say_end(player: Player, onboards: list[Onboard], held_back: int, seconds: float) -> None:
    counts = [onboard.adapter.splitter.counters for onboard in onboards]
    told = []
    if counts:
        frames, unknown, lost = (sum(getattr(c, what) for c in counts) for what in ("frames", "unknown", "lost"))
        told.append(f"{frames} frames ({unknown} unknown, {lost} lost)")
    others = player.played - held_back - sum(count.frames for count in counts)
    if others > 0:
        told.append(f"{others} samples")
    if held_back:
        told.append(f"{held_back} held back, that were for vehicles")
    say(f"{', '.join(told) or 'nothing'} in {seconds:.1f} s")
    if player.error is not None:
        raise BadInput(f"the recording could not be played to its end: {player.error}", field="file")


async def _until_over(player: Player, links: Sequence[FedLink]) -> None:
    """Until all is played and taken, or we are asked to end."""

    async def played() -> None:
        await asyncio.to_thread(player.over.wait)
        for link in links:
            await asyncio.to_thread(link.feed, None)
            await asyncio.to_thread(link.wait_taken)

    await until_any(until_stopped(), played())
    player.stop()


class Putter:
    """Puts again what came on a key, in our fleet, under the vehicle's new name; who says a state has a token, too."""

    def __init__(self, z: Client, names: dict[str, str], pattern: str | None) -> None:
        self._z, self._names, self._pattern = z, names, pattern
        self._known: dict[str, tuple[keys.Channel, str, str | None] | None] = {}
        self.held_back = 0
        self._tokens: dict[str, zenoh.LivelinessToken] = {}

    def close(self) -> None:
        for token in self._tokens.values():
            token.undeclare()

    def __call__(self, record: Record) -> None:
        try:
            known = self._known[record.key]
        except KeyError:
            known = self._known[record.key] = self._read(record.key)
        if known is None:
            return
        channel, key, name = known
        if channel.kind not in ("pub", "put") or channel is keys.TX or key.endswith(f"/{keys.ROSTER}"):
            self.held_back += 1
            return
        data = record.data if channel is not keys.STATE or name is None else self._marked(record.data, name)
        self._z.put(channel, key, data)

    def _marked(self, data: bytes, name: str) -> bytes:
        """A state that says whose it is now, and that it is a recording's."""
        with contextlib.suppress(BadInput):
            state = wire.decode(data, wire.VehicleState, "state")
            if name not in self._tokens:
                about = {"sys": state.sysid or 0, "autopilot": state.autopilot or "-", "uid": state.uid or "-"}
                instance = self._z.session.info.zid()
                key = keys.ALIVE.key(self._z.fleet_name, name, role=keys.REPLAY, instance=instance, **about)
                self._tokens[name] = self._z.session.liveliness().declare_token(key)
            state.fleet, state.name, state.replayed = self._z.fleet_name, name, True
            return wire.encode(state)
        return data

    def _read(self, key: str) -> tuple[keys.Channel, str, str | None] | None:
        channel, vehicle = vehicle_of(key)
        if channel is None:
            return None
        chunks = key.split("/")
        chunks[1] = self._z.fleet_name
        name = None
        if vehicle is not None:
            name = self._names.get(vehicle) or self._later(vehicle)
            if name is None:
                return None
            chunks[2] = name
        return channel, "/".join(chunks), name

    def _later(self, vehicle: str) -> str | None:
        """How one is called that the file named only after it was asked; None: it has no name of its own."""
        name = _renamed(vehicle, self._pattern)
        return None if name in self._names.values() else name


def _renamed(vehicle: str, pattern: str | None) -> str:
    return vehicle if pattern is None else keys.check_name(pattern.replace("*", vehicle))


def _names(recorded: Sequence[tuple[Source, list[str]]], name: str | None) -> dict[str, str]:
    """How each recorded vehicle is called now. Raises :class:`BadInput` where that cannot be."""
    in_mcap, in_tlog = (
        {each for source, whose in recorded if isinstance(source, Tlogs) == tlog for each in whose}
        for tlog in (False, True)
    )
    found = sorted(in_mcap | in_tlog)
    if in_mcap & in_tlog:
        some = ", ".join(sorted(in_mcap & in_tlog)[:5])
        text = f"{some} would be played twice, from a .tlog and from an .mcap: give one of the two, or the folder"
        raise BadConfig(text, field="file", expected="each vehicle in one kind of file")
    if not found:
        raise BadInput("the recording holds nothing that can be played", field="file", expected="a recording of zmav's")
    if name is not None and "*" not in name and len(found) > 1:
        some = ", ".join(found[:5])
        text = f"{len(found)} vehicles ({some}) cannot all be {name!r}: write a * for their own names"
        raise BadConfig(text, field="name", value=name, expected="a name with a *, as in 'old-*'")
    return {vehicle: _renamed(vehicle, name) for vehicle in found}


def _speed(text: str) -> float:
    if text == "max":
        return 0.0
    try:
        speed = float(text)
    except ValueError:
        speed = -1.0
    if not 0.0 < speed < 1e6:
        raise BadConfig(f"no speed {text!r}: expected a number above 0, or max", field="speed", value=text)
    return speed
