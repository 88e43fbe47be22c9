"""``zmav top`` as a process on a terminal of its own, and once, beside vehicles that only speak."""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import json
import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import threading
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import pytest
import zenoh
from click.testing import CliRunner, Result

import zmav
from ground.top.cli import Live, command
from ground.top.report import Report
from ground.top.terminal import ENTER, LEAVE
from ground.top.watch import Watch
from zmav import keys, wire
from zmav.session import SessionSettings

if TYPE_CHECKING:
    from tests.conftest import Net

PATIENCE_S = 30.0


class Voice:
    """Vehicles that only speak: twenty times a second what was last given for each key, until the test's end."""

    def __init__(self, session: zenoh.Session, endpoint: str) -> None:
        self.session, self.endpoint = session, endpoint
        self._sayings: dict[str, Callable[[], bytes]] = {}
        self._declared: list[Any] = []
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._speak)
        self._thread.start()

    def state(self, name: str, **more: Any) -> None:
        def say() -> bytes:
            usual: dict[str, Any] = {"connected": True, "sysid": 1, "kind": "copter", "mode": "GUIDED", "armed": True}
            return wire.encode(
                wire.VehicleState(t=time.time(), fleet="demo", name=name, instance="a", **(usual | more))
            )

        self._sayings[keys.STATE.key("demo", name)] = say

    def status(self, host: str, agent: str, state: str) -> None:
        def say() -> bytes:
            return wire.encode(wire.AgentStatus(t=time.time(), agent=agent, state=state, text="leg 2"))

        self._sayings[keys.AGENT_STATUS.key("demo", host, agent=agent)] = say

    def junk(self, key: str, data: bytes) -> None:
        self._sayings[key] = lambda: data

    def silent(self, name: str) -> None:
        del self._sayings[keys.STATE.key("demo", name)]

    def token(self, name: str, sysid: int = 1) -> zenoh.LivelinessToken:
        key = keys.ALIVE.key("demo", name, role=keys.VEHICLE, sys=sysid, autopilot="px4", uid="-", instance="a")
        return self.session.liveliness().declare_token(key)

    def link(self, name: str, loss: float = 0.0) -> None:
        """Answers to the monitor's queries."""
        key = keys.LINK.key("demo", name, link="autopilot")
        data = wire.encode(
            wire.LinkQuality(
                t=0.0, name="autopilot", url="tcp:x", state="up", age=0.1, rx_rate=42.0, rx_bytes_rate=1e3, loss=loss
            )
        )

        def answer(query: zenoh.Query) -> None:
            with query:
                query.reply(key, data)

        self._declared.append(self.session.declare_queryable(key, answer))

    def event(self, name: str, text: str, ago: float = 0.0) -> None:
        """One event, kept for who comes later, as a vehicle keeps it."""
        publisher = zenoh.ext.declare_advanced_publisher(
            self.session,
            keys.EVENT.key("demo", name),
            cache=zenoh.ext.CacheConfig(max_samples=10),
            publisher_detection=True,
            sample_miss_detection=zenoh.ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=1.0),
        )
        self._declared.append(publisher)
        publisher.put(wire.encode(wire.Event(t=time.time() - ago, kind="statustext", severity="info", text=text)))

    def _speak(self) -> None:
        while not self._over.wait(0.05):
            for key, say in list(self._sayings.items()):
                self.session.put(key, say())

    def close(self) -> None:
        self._over.set()
        self._thread.join()


@pytest.fixture
def voice(net: Net) -> Iterator[Voice]:
    voice = Voice(*net.router())
    yield voice
    voice.close()


def once(voice: Voice, *arguments: str) -> Result:
    result = CliRunner().invoke(command, [*arguments, "-e", voice.endpoint])
    assert result.exit_code == 0, result
    return result


def document(voice: Voice, *arguments: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(once(voice, "--once", "--json", *arguments).stdout)
    return found


# Once.


def test_once_as_json_tells_what_there_is(voice: Voice) -> None:
    now = time.time()
    voice.state(
        "quad1",
        battery=wire.Battery(remaining=0.12),
        velocity=(3.0, 4.0, -1.0),
        lease=wire.LeaseInfo(holder="planner", expires=now + 3600.0),
    )
    voice.link("quad1", loss=0.1)
    voice.event("quad1", "EKF3 is using GPS", ago=7.0)
    voice.status("quad1", "follower", "track")
    token = voice.token("quad2", 7)
    found = document(voice)
    one, two = found["vehicles"]
    assert (found["fleet"], one["name"], one["presence"], one["level"]) == ("demo", "quad1", "ok", "bad")
    assert [(reason["rule"], reason["level"], reason["text"]) for reason in one["reasons"]] == [
        ("battery-empty", "bad", "battery 12%"),
        ("link-loss", "warn", "MAVLink loss 10%"),
    ]
    assert "charge or change it" in one["reasons"][0]["advice"]
    assert (one["speed"], one["climb"], one["link"]["rate"]) == (5.0, 1.0, 42.0)
    assert 0.0 < one["network"]["rtt"] < PATIENCE_S
    assert 3500.0 < one["lease"]["ends_in"] < 3600.1
    assert one["events"][0]["text"] == "EKF3 is using GPS"
    assert 7.0 <= one["events"][0]["age"] < 7.0 + PATIENCE_S
    assert one["agents"] == ["follower"]
    assert [(a["name"], a["host"], a["state"]) for a in found["agents"]] == [("follower", "quad1", "track")]
    assert (two["name"], two["presence"], two["age"], two["mode"]) == ("quad2", "silent", None, None)
    token.undeclare()


def test_two_of_one_system_id_clash_and_junk_spoils_nothing(voice: Voice) -> None:
    voice.state("quad1", mode="\x1b[2J", sysid=3)
    voice.state("quad2", sysid=3, attitude=wire.Attitude(roll=0.0, pitch=0.0, yaw=1e308))
    for key in (
        keys.STATE.key("demo", "quad3"),
        keys.LINK.key("demo", "quad1", link="autopilot"),
        keys.EVENT.key("demo", "quad1"),
        keys.AGENT_STATUS.key("demo", "quad1", agent="x"),
    ):
        voice.junk(key, b'{"t": "\xff')
    result = once(voice, "--json")
    found = json.loads(result.stdout)
    assert result.stdout.isascii()
    assert "\x1b" not in result.stdout
    assert [v["name"] for v in found["vehicles"]] == ["quad1", "quad2"]
    assert [v["reasons"][0]["text"] for v in found["vehicles"]] == [
        "clash of system ids with quad2",
        "clash of system ids with quad1",
    ]


def test_without_a_terminal_it_is_printed_once_and_says_what_to_do(voice: Voice) -> None:
    voice.state("quad1", connected=False, link="down", mode="\x1b[2J")
    result = once(voice, "--wait", "1")
    head, row, *below = result.stdout.splitlines()
    assert head.split()[:2] == ["vehicle", "is"]
    assert row.split()[:2] == ["quad1", "BAD"]
    assert below == ["quad1: autopilot silent (link down)"]
    assert "\x1b" not in result.stdout
    assert "zmav top --json" in result.stderr


def test_an_empty_fleet_is_said(voice: Voice) -> None:
    assert "no vehicle is heard" in once(voice, "--once", "--wait", "0.3").stdout
    assert document(voice, "--wait", "0.3")["vehicles"] == []


# On a terminal.


class Screen:
    """The program's terminal: all it wrote, and the last frame of it as lines."""

    def __init__(self, *arguments: str, size: tuple[int, int] = (80, 24), **environment: str) -> None:
        self.master, self.slave = pty.openpty()
        self.resize(*size)
        self.before = termios.tcgetattr(self.slave)
        self.out = b""
        env = {**os.environ, "TERM": "xterm-256color", **environment}
        self.popen = subprocess.Popen(
            [sys.executable, "-m", "zmav", *arguments],
            stdin=self.slave,
            stdout=self.slave,
            stderr=self.slave,
            env=env,
            start_new_session=True,
        )

    def resize(self, columns: int, lines: int) -> None:
        fcntl.ioctl(self.slave, termios.TIOCSWINSZ, struct.pack("HHHH", lines, columns, 0, 0))

    def read(self, seconds: float) -> None:
        if select.select([self.master], [], [], seconds)[0]:
            self.out += os.read(self.master, 65536)

    @property
    def frame(self) -> list[str]:
        """Of the frames that came whole, the last."""
        frames = self.out.decode("utf-8", "replace").split("\x1b[H")[1:-1]
        return re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", frames[-1]).split("\r\n") if frames else []

    def until(self, true: Callable[[list[str]], bool]) -> list[str]:
        deadline = time.monotonic() + PATIENCE_S
        while not true(self.frame):
            assert time.monotonic() < deadline, "\n".join(self.frame) or self.out[-2000:]
            self.read(0.5)
        return self.frame

    def press(self, keys: str) -> None:
        os.write(self.master, keys.encode())

    def end(self) -> int:
        deadline = time.monotonic() + PATIENCE_S
        while self.popen.poll() is None:
            assert time.monotonic() < deadline
            self.read(0.1)
        while select.select([self.master], [], [], 0.0)[0]:
            self.read(0.0)
        return self.popen.returncode

    def given_back(self) -> bool:
        """The other screen is left, the cursor is there, and keys are lines again."""
        tail = self.out.decode("utf-8", "replace")
        return tail.count(ENTER) == tail.count(LEAVE) == 1 and termios.tcgetattr(self.slave) == self.before

    def close(self) -> None:
        if self.popen.poll() is None:
            self.popen.kill()
        self.popen.wait()
        os.close(self.master)
        os.close(self.slave)


@pytest.fixture
def screen(voice: Voice) -> Iterator[Callable[..., Screen]]:
    screens: list[Screen] = []

    def start(**how: Any) -> Screen:
        screens.append(Screen("top", "-e", voice.endpoint, **how))
        return screens[-1]

    yield start
    for each in screens:
        each.close()


def test_it_shows_resizes_filters_and_gives_the_terminal_back(voice: Voice, screen: Callable[..., Screen]) -> None:
    for i in range(30):
        voice.state(f"quad{i:02d}", sysid=i + 1)
    shown = screen()
    frame = shown.until(lambda lines: any(line.startswith("quad00") for line in lines))
    assert len(frame) == 24
    shown.until(lambda lines: "30 vehicles: 30 ok" in lines[0])
    shown.resize(200, 50)
    shown.popen.send_signal(signal.SIGWINCH)
    frame = shown.until(lambda lines: len(lines) == 50)
    assert "latitude longitude" in frame[1] and any(line.startswith("quad29") for line in frame)
    voice.silent("quad07")
    shown.press("/stale gone\r")
    shown.press("\x1b")
    shown.press("/gone\r")
    frame = shown.until(lambda lines: any(line.startswith("quad07") for line in lines) and "1 shown" in lines[0])
    assert "GONE" in frame[2] and "no state for" in frame[2]
    shown.press("q")
    assert shown.end() == 0
    assert shown.given_back()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_told_to_end_it_gives_the_terminal_back(
    voice: Voice, screen: Callable[..., Screen], number: signal.Signals
) -> None:
    voice.state("quad1")
    shown = screen(NO_COLOR="1")
    shown.until(lambda lines: any(line.startswith("quad1") for line in lines))
    assert b"\x1b[3" not in shown.out.replace(b"\x1b[3J", b"")  # no colours
    shown.popen.send_signal(number)
    assert shown.end() == 0
    assert shown.given_back()


def test_a_terminal_that_takes_no_more_holds_nothing_up(voice: Voice, screen: Callable[..., Screen]) -> None:
    """Ctrl-S, and nothing is taken any more; told to end, it ends, and the terminal goes on."""
    voice.state("quad1")
    shown = screen()
    shown.until(lambda lines: any(line.startswith("quad1") for line in lines))
    shown.press("\x13")
    deadline, size = time.monotonic() + PATIENCE_S, -1
    while len(shown.out) != size:  # the clock in the first line changes every second
        assert time.monotonic() < deadline, "Ctrl-S stopped nothing"
        size = len(shown.out)
        shown.read(2.5)
    shown.popen.terminate()
    assert shown.end() == 0
    assert shown.given_back()


class Broken(Watch):
    """A monitor with a defect that shows after some frames."""

    def __init__(self, z: zmav.Client) -> None:
        super().__init__(z)
        self.frames = 0

    def report(self) -> Report:
        self.frames += 1
        if self.frames > 2:
            raise RuntimeError("a defect")
        return super().report()


async def test_a_crash_gives_the_terminal_back(voice: Voice) -> None:
    master, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
    before = termios.tcgetattr(slave)
    with contextlib.ExitStack() as stack:
        stack.callback(os.close, master)
        stack.callback(os.close, slave)
        async with zmav.open(settings=SessionSettings(connect=[voice.endpoint])) as z:
            with pytest.raises(RuntimeError, match="a defect"):
                await Live(Broken(z), slave).run()
        said = b""
        while select.select([master], [], [], 0.0)[0]:
            said += os.read(master, 65536)
        assert said.decode().endswith(LEAVE)
        assert termios.tcgetattr(slave) == before


# What is heard while it goes on.


async def test_who_falls_silent_is_stale_with_a_token_and_gone_without(voice: Voice) -> None:
    voice.state("quad1")
    token = voice.token("quad1")
    async with zmav.open(settings=SessionSettings(connect=[voice.endpoint])) as z:
        watch = Watch(z)
        watching = asyncio.create_task(watch.run())
        await z.wait_for("quad1")

        async def until(presence: str) -> None:
            while [v.presence for v in watch.report().vehicles] != [presence]:
                await asyncio.sleep(0.05)

        await asyncio.wait_for(until("ok"), PATIENCE_S)
        voice.silent("quad1")
        await asyncio.wait_for(until("stale"), PATIENCE_S)
        token.undeclare()
        await asyncio.wait_for(until("gone"), PATIENCE_S)
        (vehicle,) = watch.report().vehicles
        assert vehicle.mode == "GUIDED"  # the last that was heard
        assert vehicle.age is not None and vehicle.age > 2.0
        assert watch.report().router
        voice.close()
        voice.session.close()

        async def until_alone() -> None:
            while watch.report().router:
                await asyncio.sleep(0.05)

        await asyncio.wait_for(until_alone(), PATIENCE_S)
        watching.cancel()


async def test_drops_of_the_last_seconds_are_told(voice: Voice) -> None:
    voice.state("quad1", setpoints={"flown": 100, "late": 5})
    async with zmav.open(settings=SessionSettings(connect=[voice.endpoint])) as z:
        watch = Watch(z)
        watching = asyncio.create_task(watch.run())
        await z.wait_for("quad1")
        assert watch.report().vehicles[0].reasons == []  # those of before we came are old
        voice.state("quad1", setpoints={"flown": 200, "late": 9, "held": 1}, forbidden={"missing": 2})

        async def until_told() -> list[str]:
            while len(reasons := watch.report().vehicles[0].reasons) < 2:
                await asyncio.sleep(0.05)
            return [reason.text for reason in reasons]

        said = await asyncio.wait_for(until_told(), PATIENCE_S)
        assert said == ["setpoints dropped: 4 late", "orders without proof refused: 2 missing"]
        watching.cancel()
