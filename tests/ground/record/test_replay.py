"""Recordings played again: in step, byte for byte, and never as orders to a vehicle that is there."""

from __future__ import annotations

import asyncio
import json
import shutil
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import zenoh

from ground.record import mcapfile, sources
from ground.record.folder import Folder, Record
from ground.record.mcapfile import Mcap
from ground.record.replay import FedLink, Player
from ground.record.sources import Tlogs
from ground.record.storage import RecordingSettings, Storage
from tests.cli.conftest import Here
from tests.ground.record.conftest import Frames
from zmav import keys, wire
from zmav.errors import BadConfig, BadInput, Clash
from zmav.mavlink import load_dialect

if TYPE_CHECKING:
    from tests.conftest import Net

START_US = 1_700_000_000_000_000
PATIENT = "transport/link/tx/queue/congestion_control/drop/wait_before_drop:5000000"


def tlog(path: Path, frames: Frames, *seconds: float) -> Path:
    """Write a .tlog with a frame at each time."""
    path.write_bytes(b"".join(struct.pack(">Q", START_US + int(1e6 * t)) + frames() for t in seconds))
    return path


class Clock:
    """Time that passes only while somebody waits."""

    def __init__(self) -> None:
        self.t = 1000.0

    def __call__(self) -> float:
        return self.t

    def pause(self, seconds: float) -> bool:
        self.t += seconds
        return False


def play(parts: list[tuple[Any, str]], **how: Any) -> list[tuple[float, str, bytes]]:
    """(when by the clock since the start, who, payload) of all that is played."""
    clock, found = Clock(), list[tuple[float, str, bytes]]()

    def deliver(who: str) -> Any:
        return lambda record: found.append((round(clock.t - 1000.0, 6), who, record.data))

    player = Player([(source, deliver(who)) for source, who in parts], now=clock, pause=clock.pause, **how)
    player.start()
    assert player.over.wait(30.0)
    assert player.error is None
    return found


def test_several_recordings_go_by_one_clock(tmp_path: Path) -> None:
    one, two = Frames(1), Frames(2)
    a = Tlogs("a", [tlog(tmp_path / "a.tlog", one, 0.0, 1.0, 2.0)])
    b = Tlogs("b", [tlog(tmp_path / "b.tlog", two, 0.5, 1.5), tlog(tmp_path / "b2.tlog", two, 2.5)])
    both = [(a, "a"), (b, "b")]
    order = [(0.0, "a"), (0.5, "b"), (1.0, "a"), (1.5, "b"), (2.0, "a"), (2.5, "b")]
    assert [(t, who) for t, who, _ in play(both)] == order
    assert [data for _, who, data in play(both) if who == "b"] == two.made
    assert [(t, who) for t, who, _ in play(both, speed=2.0)] == [(t / 2, who) for t, who in order]
    assert {t for t, _, _ in play(both, speed=0.0)} == {0.0}
    assert [(t, who) for t, who, _ in play(both, start=0.9)] == [
        (0.1, "a"),
        (0.6, "b"),
        (1.1, "a"),
        (1.6, "b"),
    ]
    assert play(both, start=9.0) == []


def test_a_pause_of_hours_is_played_as_no_time(tmp_path: Path) -> None:
    source = Tlogs("a", [tlog(tmp_path / "a.tlog", Frames(), 0.0, 1.0, 7201.0, 7202.0, 100.0, 101.0)])
    assert [t for t, _, _ in play([(source, "a")])] == [0.0, 1.0, 1.0, 2.0, 2.0, 3.0]


def test_a_loop_begins_again_until_it_is_ended(tmp_path: Path) -> None:
    clock, found = Clock(), list[bytes]()
    make = Frames()
    source = Tlogs("a", [tlog(tmp_path / "a.tlog", make, 0.0, 1.0)])

    def deliver(record: Record) -> None:
        found.append(record.data)
        if len(found) == 5:
            player.stop()

    player = Player([(source, deliver)], loop=True, now=clock, pause=clock.pause)
    player.start()
    assert player.over.wait(30.0)
    assert found == [*make.made, *make.made, make.made[0]]


def test_what_holds_nothing_is_no_endless_loop(tmp_path: Path) -> None:
    (tmp_path / "empty.tlog").write_bytes(b"")
    assert play([(Tlogs("a", [tmp_path / "empty.tlog"]), "a")], loop=True) == []


def test_a_fed_link_gives_its_frames_and_ends() -> None:
    from zmav.links import LinkState

    link, heard = FedLink("x"), list[bytes]()
    link.start(heard.append, lambda state, detail: None)
    for data in (b"1", b"2", None):
        link.feed(data)
    link.wait_taken()
    assert link.wait(LinkState.DOWN, 30.0)
    assert heard == [b"1", b"2"]
    assert not link.send(b"x")
    link.close()
    link.feed(b"3")  # nobody's any more


def test_names_of_what_is_played(tmp_path: Path) -> None:
    for name in ("quad1.001.tlog", "quad1.002.tlog", "north.quad2.001.tlog", "My Flight.tlog"):
        tlog(tmp_path / name, Frames(), 0.0)

    def names(*paths: str) -> list[str]:
        return sorted(v for source in sources.open_all([tmp_path / p for p in paths]) for v in source.vehicles())

    assert names(".") == ["my-flight", "quad1", "quad2"]
    assert names("My Flight.tlog") == ["replay"]
    assert names("quad1.002.tlog") == ["quad1"]
    (tmp_path / "none").mkdir()
    with pytest.raises(BadConfig, match=r"no \.mcap and no \.tlog there"):
        names("none")
    (tmp_path / "x.mcap").write_bytes(b"no recording at all")
    with pytest.raises(BadInput, match=r"no \.mcap"):
        names("x.mcap")


def test_a_file_that_holds_nothing_more_keeps_no_other_from_being_played(tmp_path: Path) -> None:
    (tmp_path / "quad1.001.tlog").write_bytes(bytes(4096))  # as a power cut leaves it
    tlog(tmp_path / "quad2.001.tlog", Frames(), 0.0)
    said: list[str] = []
    assert [whose for _, whose in sources.readable(sources.open_all([tmp_path]), said.append)] == [["quad2"]]
    (line,) = said
    assert line.startswith(f"left out: {tmp_path / 'quad1.001.tlog'} holds no MAVLink")
    with pytest.raises(BadInput, match=r"quad1.*holds no MAVLink"):
        sources.readable(sources.open_all([tmp_path / "quad1.001.tlog"]), said.append)


EVENT = wire.encode(wire.Event(t=1.0, kind="mode", severity="info", text="GUIDED"))
SETPOINT = wire.encode(wire.Setpoint(lease="x", seq=1, deadline=1.0, pos=(1.0, 2.0, 3.0)))


class Recorded:
    """A session with two vehicles: what came on each key, in order."""

    def __init__(self, folder: Path) -> None:
        make, other = Frames(1), Frames(2)
        self.came: list[tuple[str, bytes]] = []
        for _ in range(20):
            self.came += [(f"zmav/demo/quad1/{make.key}", make()), (f"zmav/demo/quad2/{other.key}", other())]
        self.came += [
            ("zmav/demo/quad1/mav/rx/1/1/ATTITUDE", make()),
            ("zmav/demo/quad1/event", EVENT),
            ("zmav/demo/quad1/setpoint/swap", SETPOINT),
            ("zmav/demo/quad1/mav/tx/1/1/ATTITUDE", make()),
            ("zmav/demo/quad2/state", b"no JSON"),
            ("zmav/demo/@fleet/goal", b'{"quad1": [1, 2, 3]}'),
            ("zmav/demo/@fleet/roster", b'{"n": 1}'),
        ]
        with Folder(folder) as out:
            storage = Storage(out, RecordingSettings(keep_free=0), load_dialect(), lambda line: None)
            storage.start()
            for number, (key, data) in enumerate(self.came):
                storage.put(key, data, at=START_US * 1000 + number * 1_000_000)
            storage.close()
        self.session = storage.session


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Recorded]:
    yield Recorded(tmp_path_factory.mktemp("recorded"))


def test_an_mcap_gives_back_every_key_and_byte(recorded: Recorded, tmp_path: Path) -> None:
    """Also one that was cut short, as far as it goes."""
    (path,) = recorded.session.glob("*.mcap")
    played = [(record.key, record.data) for record in Mcap(path).records()]
    without_tx = [(key, data) for key, data in recorded.came if "/mav/tx/" not in key]
    assert [each for each in played if "/mav/tx/" not in each[0]] == without_tx
    assert Mcap(path).vehicles() == ["quad1", "quad2"]
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(path.read_bytes()[:-20])
    assert [(record.key, record.data) for record in Mcap(cut).records()] == played
    assert Mcap(cut).vehicles() == ["quad1", "quad2"]
    assert mcapfile.about(cut)["dialect"] == "ardupilotmega"


def expected(recorded: Recorded, *, name: str = "*") -> list[tuple[str, bytes]]:
    """All but what was for vehicles, in the fleet of recordings."""
    found = []
    for key, data in recorded.came:
        if "/mav/tx/" in key or "roster" in key:
            continue
        chunks = key.split("/")
        chunks[1] = "demo-replay"
        chunks[2] = chunks[2] if chunks[2].startswith("@") else name.replace("*", chunks[2])
        found.append(("/".join(chunks), data))
    return sorted(found)


class Stage:
    """A router of a fleet, and what is heard there."""

    def __init__(self, net: Net) -> None:
        self.router, self.endpoint = net.router(cfg=[PATIENT])
        self.heard: list[tuple[str, bytes]] = []
        for key in ("zmav/**", "zmav/*/@fleet/**"):
            self.router.declare_subscriber(key, self._on_sample)

    def _on_sample(self, sample: zenoh.Sample) -> None:
        self.heard.append((str(sample.key_expr), sample.payload.to_bytes()))

    async def replay(self, recorded: Recorded, *arguments: str, fails: bool = False, files: Sequence[Path] = ()) -> Any:
        verb = Here("-e", self.endpoint)
        told = verb.fails if fails else verb
        paths = map(str, files or [recorded.session])
        return await asyncio.to_thread(told, "replay", *paths, "--speed", "max", *arguments)

    async def until(self, count: int) -> list[tuple[str, bytes]]:
        for _ in range(1500):
            if len(self.heard) >= count:
                break
            await asyncio.sleep(0.02)
        return sorted(self.heard)

    def vehicle(self, name: str) -> Any:
        """A vehicle comes to be there: its token; call ``undeclare``."""
        key = keys.ALIVE.key("demo", name, role="vehicle", sys=1, autopilot="px4", uid="-", instance="real")
        return self.router.liveliness().declare_token(key)


@pytest.fixture
def stage(net: Net) -> Stage:
    return Stage(net)


@pytest.fixture(autouse=True)
def ended(monkeypatch: pytest.MonkeyPatch) -> asyncio.Event:
    """Verbs run in threads here, where no signal can be heard: they end by themselves, or by this."""
    event = asyncio.Event()
    monkeypatch.setattr("ground.record.replay.until_stopped", event.wait)
    return event


async def test_all_comes_again_but_what_was_sent_to_vehicles_in_a_fleet_of_its_own(
    stage: Stage, recorded: Recorded
) -> None:
    """Beside the vehicle itself, too, which is in another fleet."""
    token = stage.vehicle("quad1")
    told = await stage.replay(recorded)
    wanted = expected(recorded)
    assert await stage.until(len(wanted)) == wanted
    assert "demo-replay/quad1, demo-replay/quad2" in told.err
    assert "look at it: zmav ls --fleet demo-replay" in told.err
    assert "45 samples, 2 held back" in told.err
    token.undeclare()


async def test_under_another_name_and_in_a_named_fleet(stage: Stage, recorded: Recorded) -> None:
    await stage.replay(recorded, "--as", "old-*", "--fleet", "demo-replay")
    wanted = expected(recorded, name="old-*")
    assert await stage.until(len(wanted)) == wanted


async def test_a_file_that_is_still_written_to_may_name_more_vehicles_later(
    stage: Stage, recorded: Recorded, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, asked = Mcap.vehicles, list[Mcap]()

    def growing(self: Mcap) -> list[str]:
        asked.append(self)
        return whole(self)[: len(asked)]

    monkeypatch.setattr(Mcap, "vehicles", growing)
    told = await stage.replay(recorded)
    assert "as demo-replay/quad1\n" in told.err
    wanted = expected(recorded)
    assert await stage.until(len(wanted)) == wanted, "what came later is played under its own name"


async def test_what_is_played_already_is_not_played_over(stage: Stage, recorded: Recorded) -> None:
    key = keys.ALIVE.key("demo-replay", "quad1", role="replay", sys=1, autopilot="px4", uid="-", instance="other")
    token = stage.router.liveliness().declare_token(key)
    told = await stage.replay(recorded, fails=True)
    assert isinstance(told.error, Clash)
    assert "quad1: played already in demo-replay: --as 'old-*'" in str(told.error)
    assert stage.heard == []
    token.undeclare()


def test_a_folder_means_its_newest_session(recorded: Recorded, tmp_path: Path) -> None:
    """As the recorder leaves them."""
    for name in ("2026-11-21_10-00-00", "2026-11-22_10-00-00"):
        shutil.copytree(recorded.session, tmp_path / name)
    (tmp_path / "2026-11-23_10-00-00").mkdir()
    newest = tmp_path / "2026-11-22_10-00-00"
    (source,) = sources.open_all([tmp_path])
    assert source.label == str(newest / "record.001.mcap")
    with pytest.raises(BadConfig, match=r"no \.mcap and no \.tlog there"):
        sources.open_all([tmp_path / "*.bin"])


def labels(*paths: Path) -> list[str]:
    return sorted(source.label for source in sources.open_all(paths))


def test_the_newest_session_comes_first_whatever_it_has(recorded: Recorded, tmp_path: Path) -> None:
    """One without an .mcap, too, and before what lies beside it; a folder of another name is no session."""
    (tlog,) = recorded.session.glob("quad1.*.tlog")
    for name in ("2026-11-21_10-00-00", "older", "z"):
        shutil.copytree(recorded.session, tmp_path / name)
    for number in ("", ".2", ".10"):
        (tmp_path / f"2026-11-22_10-00-00{number}").mkdir()
        shutil.copy(tlog, tmp_path / f"2026-11-22_10-00-00{number}" / tlog.name)
    newest = str(tmp_path / "2026-11-22_10-00-00.10" / tlog.name)
    assert labels(tmp_path) == [newest]
    shutil.copy(tlog, tmp_path / "mine.tlog")
    assert labels(tmp_path) == [newest]
    assert labels(tmp_path / "z") == [str(tmp_path / "z" / "record.001.mcap")]
    assert labels(tmp_path / "mine.tlog") == [str(tmp_path / "mine.tlog")]


def test_a_name_is_of_that_file_and_no_other(recorded: Recorded, tmp_path: Path) -> None:
    shutil.copytree(recorded.session, tmp_path / "2026-11-21_10-00-00")
    for name in ("record.001.mcap", "quad1.001.tlog"):
        with pytest.raises(BadConfig, match=r"no \.mcap and no \.tlog there"):
            sources.open_all([tmp_path / name])


@pytest.mark.parametrize("name", ["**x", "a**b.mcap", "x" * 300])
def test_a_name_that_cannot_be_is_refused_in_words(name: str, tmp_path: Path) -> None:
    with pytest.raises(BadConfig) as told:
        sources.open_all([tmp_path / name])
    assert told.value.detail["field"] == "file" and told.value.detail["value"] == str(tmp_path / name)


async def test_a_state_says_that_it_is_a_recording(stage: Stage, tmp_path: Path, ended: asyncio.Event) -> None:
    """... in its fleet's name, its field and its token; and what looks at the fleet says so."""
    said = wire.VehicleState(t=1.0, fleet="demo", name="quad1", instance="a", connected=True, sysid=1, armed=True)
    with Folder(tmp_path) as out:
        storage = Storage(out, RecordingSettings(keep_free=0), load_dialect(), lambda line: None)
        storage.start()
        for number in range(200):
            storage.put("zmav/demo/quad1/state", wire.encode(said), at=START_US * 1000 + number * 100_000_000)
        storage.close()
    verb = Here("-e", stage.endpoint)
    replay = asyncio.create_task(asyncio.to_thread(verb, "replay", str(tmp_path), "--loop"))
    await stage.until(3)
    state = wire.decode(stage.heard[0][1], wire.VehicleState, "state")
    assert (state.fleet, state.name, state.replayed) == ("demo-replay", "quad1", True)
    tokens = [str(reply.ok.key_expr) for reply in stage.router.liveliness().get("zmav/**") if reply.ok]
    assert [token.split("/")[1:6] for token in tokens] == [["demo-replay", "quad1", "alive", "replay", "1"]]
    told = await asyncio.to_thread(verb, "ls", "--fleet", "demo-replay")
    assert "quad1: a recording: it takes no orders" in told.out
    for fleet in ("demo", "*"):
        told = await asyncio.to_thread(verb, "ls", "--fleet", fleet, "--wait", "0.5")
        assert "quad1" not in told.out, "who looks at vehicles sees no recording"
    told = await asyncio.to_thread(verb, "do", "quad1", "hold", "--fleet", "demo-replay")
    assert told.out == "quad1: hold left out: it is a recording\n"
    ended.set()
    await replay


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--as", "old"], "2 vehicles (quad1, quad2) cannot all be 'old'"),
        (["--as", "Old *"], "cannot stand in a key"),
        (["--speed", "0"], "no speed '0'"),
        (["--fleet", "*"], "cannot stand in a key"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
async def test_what_cannot_be_is_said(stage: Stage, recorded: Recorded, arguments: list[str], words: str) -> None:
    told = await stage.replay(recorded, *arguments, fails=True)
    assert words in str(told.error)
    assert stage.heard == []


async def test_no_vehicle_is_played_from_both_kinds_of_file(stage: Stage, recorded: Recorded) -> None:
    told = await stage.replay(recorded, fails=True, files=sorted(recorded.session.iterdir()))
    assert "quad1, quad2 would be played twice" in str(told.error)
    assert stage.heard == []


async def test_several_tlogs_are_several_vehicles(stage: Stage, recorded: Recorded) -> None:
    files = [str(path) for path in sorted(recorded.session.glob("*.tlog"))]
    told = await asyncio.to_thread(Here("-e", stage.endpoint), "replay", *files, "--speed", "max", "--as", "old-*")
    assert "42 frames (0 unknown" in told.err
    own = [(key, data) for key, data in recorded.came if "/mav/" in key]
    await stage.until(len(own))
    frames = sorted(data for key, data in stage.heard if "/mav/rx/" in key)
    assert frames == sorted(data for _, data in own)
    assert {key.split("/")[2] for key, _ in stage.heard} == {"old-quad1", "old-quad2"}
    states = [json.loads(data) for key, data in stage.heard if key.endswith("/state")]
    assert {state["name"] for state in states} <= {"old-quad1", "old-quad2"}
