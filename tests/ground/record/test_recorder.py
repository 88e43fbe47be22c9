"""The recorder on the key space: what it hears, what it answers, and what is left of it when it is killed."""

from __future__ import annotations

import asyncio
import json
import signal
import sys
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import zenoh
from mcap.reader import make_reader
from pymavlink import mavutil

import zmav
from ground.record import schemas
from ground.record.folder import Folder, is_whole
from ground.record.history import END, MOST_ENTRIES, RING
from ground.record.part import Asked
from ground.record.recorder import Recorder, Wanted
from ground.record.storage import RecordingSettings
from tests.cli.conftest import Here, Process
from tests.ground.record.conftest import Frames, read, read_cut
from tests.waiting import until
from zmav import keys, wire
from zmav.client import Answer, Client
from zmav.errors import BadConfig, BadInput, Refused, ZmavError

if TYPE_CHECKING:
    from tests.conftest import Net

PATIENCE_S = 30.0
FIVE = [f"quad{n}" for n in range(1, 6)]


class Recording:
    """A running recorder, the fleet's router, and a ground station that asks."""

    def __init__(self, recorder: Recorder, router: zenoh.Session, z: Client, folder: Folder) -> None:
        self.recorder, self.router, self.z, self.folder = recorder, router, z, folder

    def put(self, key: str, data: bytes) -> None:
        self.router.put(f"zmav/demo/{key}", data, congestion_control=zenoh.CongestionControl.BLOCK)

    async def taken(self, count: int) -> None:
        """Until so many samples, besides the recorder's own status, are in the files."""
        own = 0

        def there() -> bool:
            nonlocal own
            mine = Asked("demo", self.recorder.name, "agent_status")
            own = len(self.recorder.storage.history.newest(mine, 0, END, 1000)[0])
            return self.recorder.storage.counts.written - own >= count

        await until(there, lambda: f"{self.recorder.storage.counts}, {own} its own")

    async def ask(self, what: str, **query: Any) -> wire.History:
        (found,) = await self.ask_all(what, **query)
        return found

    async def ask_all(self, what: str, **query: Any) -> list[wire.History]:
        payload = json.dumps(query).encode() if query else b""
        answers = await self.z.ask(f"zmav/demo/*/history/{what}", payload, PATIENCE_S, keys.HISTORY)
        for answer in answers:
            if isinstance(answer, ZmavError):
                raise answer
        found = [wire.decode(a.payload, wire.History, "history") for a in answers if isinstance(a, Answer)]
        return sorted(found, key=lambda each: (each.of, each.what))


@pytest.fixture
async def recording(net: Net, tmp_path: Path) -> AsyncIterator[Recording]:
    router, endpoint = net.router()
    settings = RecordingSettings(keep_free=0, flush=0.1)
    with Folder(tmp_path / "out") as folder:
        async with (
            zmav.open(connect=[endpoint]) as z,
            zmav.open(connect=[endpoint]) as asking,
            Recorder(z, folder, settings, Wanted(name="gs"), lambda line: None) as recorder,
        ):
            for key in ("state", "event", "mav/rx/1/1/ATTITUDE", "setpoint/x"):
                await net.linked(router, f"zmav/demo/quad1/{key}")
            await net.linked(router, "zmav/demo/@fleet/plan")
            yield Recording(recorder, router, asking, folder)


async def test_all_that_the_registry_says_is_recorded(recording: Recording) -> None:
    make = Frames()
    sent = {
        "quad1/mav/rx/1/1/ATTITUDE": make(),
        "quad1/mav/tx/1/1/ATTITUDE": make(),
        "quad1/state": wire.encode(wire.VehicleState(t=1.0, fleet="demo", name="quad1", instance="i")),
        "quad1/event": b'{"t": 1.0, "kind": "mode", "severity": "info", "text": "GUIDED"}',
        "quad1/setpoint/swap": b'{"lease": "x", "seq": 1, "deadline": 5.0, "pos": [1, 2, 3]}',
        "quad1/link/autopilot": b'{"t": 1.0}',
        "quad1/agent/swap/status": b'{"t": 1.0, "agent": "swap"}',
        "@fleet/plan": b'{"quad1": []}',
        "@fleet/traffic": b'{"t": 1.0, "source": "gs", "instance": 1}',
        "@obstacle/tower": b'{"name": "tower", "t": 1.0, "what": null}',
        "quad1/camera/down/detection": b'{"t": 1.0, "camera": "down", "found": []}',
        "quad1/agent/ev1/out/signals": b'{"t": 1.0, "values": {"ref.x": 1.0}}',
        "quad1/agent/ev1/param/kp": b'{"value": 1.0, "default": 1.0, "low": 0.0, "high": 2.0}',
    }
    recorded = {c.name for c in keys.CHANNELS.values() if c.recorded and c.kind in ("pub", "put")}
    assert {keys.match(f"zmav/demo/{key}")[0].name for key in sent} == recorded
    for key, data in sent.items():
        recording.put(key, data)
    await recording.taken(len(sent))
    await recording.recorder.close()
    (path,) = recording.recorder.storage.session.glob("*.mcap")
    kept = dict(read(path, schemas.AS_IT_CAME))
    assert {key: kept.get(f"zmav/demo/{key}") for key in sent if "/mav/" not in key} == {
        key: data for key, data in sent.items() if "/mav/" not in key
    }
    assert {data for _, data in read(path, schemas.ALL_FRAMES)} == set(make.made)


async def test_signals_are_numbers_that_readers_can_list(recording: Recording) -> None:
    """Each file's schema has the names that came first; what cannot be understood is kept with none."""
    samples = [b'{"t": 5.5, "values": {"ref.x": 1.0, "is.x": 0.5}}', b'{"t": 5.75, "values": {"ref.x": 2.0, "new": 1}}']
    for sample in samples:
        recording.put("quad1/agent/ev1/out/signals", sample)
    recording.put("quad1/agent/odd/out/signals", b'{"t": 1.0, "values": [1]}')
    await recording.taken(3)
    await recording.recorder.close()
    (path,) = recording.recorder.storage.session.glob("*.mcap")
    found: dict[str, list[Any]] = {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            assert schema is not None
            found.setdefault(channel.topic, []).append((message.publish_time, message.data, json.loads(schema.data)))
    signals = found["zmav/demo/quad1/agent/ev1/out/signals"]
    assert [(t, data) for t, data, _ in signals] == list(zip((5_500_000_000, 5_750_000_000), samples, strict=True))
    number = {"type": "number"}
    assert signals[0][2]["properties"] == {
        "t": number,
        "values": {"type": "object", "properties": {"ref.x": number, "is.x": number}},
    }
    ((_, odd, schema),) = found["zmav/demo/quad1/agent/odd/out/signals"]
    assert odd == b'{"t": 1.0, "values": [1]}'
    assert schema["properties"]["values"] == {"type": "object", "properties": {}}


async def test_patterns_that_overlap_bring_nothing_twice(recording: Recording, tmp_path: Path) -> None:
    with Folder(tmp_path / "second") as folder:
        wanted = Wanted(vehicles=("quad*", "*1"), name="other")
        async with Recorder(recording.z, folder, RecordingSettings(keep_free=0), wanted, lambda line: None) as both:
            history, found = both.storage.history, set[str]()
            while not {"quad1", "plane1"} <= found:  # it hears
                for name in ("quad1", "plane1", "plane2"):
                    recording.put(f"{name}/link/first", b"{}")
                await asyncio.sleep(0.02)
                found = {asked.of for asked in history.known()}
            for name in ("quad1", "plane1", "plane2"):
                recording.put(f"{name}/link/x", b"{}")
                recording.put(f"{name}/link/last", b"{}")
            last = Asked("demo", "plane1", "link")
            await until(
                lambda: any(entry.key.endswith("last") for entry in history.newest(last, 0, END, 1000)[0]),
                lambda: str(history.known()),
            )
    kept = [key for path in both.storage.session.glob("*.mcap") for key, _ in read(path, schemas.AS_IT_CAME)]
    assert kept.count("zmav/demo/quad1/link/x") == 1
    assert kept.count("zmav/demo/plane1/link/x") == 1
    assert not any("plane2" in key for key in kept)


async def test_what_was_is_told_when_the_vehicle_is_gone(recording: Recording) -> None:
    make = Frames()
    begun = time.time()
    for number in range(5):
        recording.put("quad1/event", json.dumps({"t": number, "kind": "x", "severity": "info", "text": "t"}).encode())
    recording.put("quad1/mav/rx/1/1/ATTITUDE", make())
    await recording.taken(6)

    last = await recording.ask("quad1/event")
    assert (last.recorder, last.of, last.what, last.more) == ("gs", "quad1", "event", True)
    assert [entry.value["t"] for entry in last.entries] == [4]
    assert begun <= last.entries[0].t <= time.time()
    every = await recording.ask("quad1/event", last=5)
    assert [entry.value["t"] for entry in every.entries] == [0, 1, 2, 3, 4]
    middle = await recording.ask("quad1/event", since=every.entries[1].t - 1e-6, until=every.entries[3].t + 1e-6)
    assert [entry.value["t"] for entry in middle.entries] == [1, 2, 3]
    assert not middle.more
    attitude = await recording.ask("quad1/ATTITUDE")
    assert attitude.entries[0].value["time_boot_ms"] == 0
    assert {found.what for found in await recording.ask_all("quad1/*")} == {"event", "ATTITUDE"}
    assert await recording.ask_all("quad9/*") == []


@pytest.mark.parametrize(
    ("query", "words"),
    [
        ({"last": 0}, "last"),
        ({"last": 5000}, "last"),
        ({"since": "now"}, "since"),
        ({"wen": 1}, "wen"),
        ({"since": 2.0, "until": 1.0}, "after until"),
    ],
)
async def test_a_bad_question_is_answered_with_why(recording: Recording, query: dict[str, Any], words: str) -> None:
    with pytest.raises(BadInput, match=words):
        await recording.ask("quad1/state", **query)


async def test_a_time_later_than_any_there_is_finds_nothing(recording: Recording) -> None:
    recording.put("quad1/link/x", b"{}")
    await recording.taken(1)
    assert (await recording.ask("quad1/link", since=1e308)).entries == []


async def test_memory_holds_more_than_one_answer_does(recording: Recording) -> None:
    for number in range(20):
        recording.put("quad1/link/x", json.dumps({"n": number, "x": "y" * 10_000}).encode())
    await recording.taken(20)
    assert (await recording.ask("quad1/link", until=time.time(), last=3)).entries[0].value["n"] == 17
    kept = recording.recorder.storage.history.newest(Asked("demo", "quad1", "link"), 0, END, 100)[0]
    assert len(kept) == 20


async def test_an_answer_is_bounded(recording: Recording) -> None:
    for number in range(20):
        recording.put("quad1/link/x", json.dumps({"n": number, "x": "y" * 10_000}).encode())
    await recording.taken(20)
    found = await recording.ask("quad1/link", last=20)
    assert found.more
    assert 1 <= len(found.entries) < 20
    assert found.entries[-1].value["n"] == 19


async def test_a_question_for_too_much_is_refused(recording: Recording) -> None:
    count = MOST_ENTRIES // RING + 1
    for number in range(count):
        recording.put(f"quad{number}/link/x", b"{}")
    await recording.taken(count)
    with pytest.raises(Refused, match="too much at a time"):
        await recording.ask_all("*/*", last=RING)
    assert len(await recording.ask_all("*/*", last=1)) >= count


async def test_a_recorder_tells_how_it_does_and_shares_no_folder(recording: Recording, tmp_path: Path) -> None:
    recording.put("quad7/link/x", b'{"n": 7}')
    await recording.taken(1)
    status = recording.recorder.status()
    assert (status.state, status.detail["dropped"]) == ("recording", 0)
    with pytest.raises(BadConfig, match="another recorder"):
        Folder(tmp_path / "out")


async def test_killed_in_the_middle_it_leaves_all_that_it_had_written(net: Net, tmp_path: Path) -> None:
    """Five vehicles, recorded by a process that gets SIGKILL: what its status said is written is there."""
    router, endpoint = net.router()
    out = tmp_path / "out"
    command = ("record", "--out", str(out), "-e", endpoint, "--keep-free", "0", "--name", "gs")
    process = Process(sys.executable, "-m", "zmav", *command)
    process.expect("recording demo/*")
    written = 0

    def on_status(sample: zenoh.Sample) -> None:
        nonlocal written
        written = json.loads(sample.payload.to_bytes())["detail"]["written"]

    router.declare_subscriber("zmav/demo/gs/agent/recorder/status", on_status)
    await net.linked(router, "zmav/demo/quad1/mav/rx/1/1/ATTITUDE")
    makes = [Frames(sysid) for sysid in range(1, 6)]
    try:
        while written < 500:
            for name, make in zip(FIVE, makes, strict=True):
                router.put(f"zmav/demo/{name}/{make.key}", make())
            await asyncio.sleep(0.002)
    finally:
        process.popen.send_signal(signal.SIGKILL)
        process.wait()
    (session,) = [path for path in out.iterdir() if path.is_dir()]
    (cut,) = session.glob("*.mcap")
    assert not is_whole(cut)
    for ended in (read_cut, read):
        kept = ended(cut, schemas.ALL_FRAMES)
        assert len(kept) >= 490  # of the 500, a few may have been the recorder's own status
        for name, make in zip(FIVE, makes, strict=True):
            own = [frame for topic, frame in kept if topic == f"zmav/demo/{name}/mav/rx"]
            assert own == make.made[: len(own)], "without a gap"
        if ended is read_cut:
            assert "completed; it holds" in Here()("record", "--repair", str(cut)).err
    by_pymavlink = 0
    for name, make in zip(FIVE, makes, strict=True):
        log = mavutil.mavlink_connection(str(session / f"{name}.001.tlog"))
        while (message := log.recv_match()) is not None:
            assert message.get_type() == "ATTITUDE"
            assert bytes(message.get_msgbuf()) == make.made[message.time_boot_ms]
            by_pymavlink += 1
    assert by_pymavlink >= 490


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--vehicles", "a b"], "no vehicle can be called 'a b'"),
        (["--name", "Ground One"], "cannot stand in a key"),
        (["--want", "ATTITUDE"], "expected ATTITUDE=10"),
        (["--want", "ATTITUDE=-1"], "no rate -1"),
        (["--repair", __file__], r"is no .mcap"),
        (["--out", "/dev/null/x"], "cannot record to"),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else None,
)
def test_what_cannot_be_is_said(net: Net, tmp_path: Path, arguments: list[str], words: str) -> None:
    _, endpoint = net.router()
    told = Here("-e", endpoint).fails("record", "--out", str(tmp_path / "out"), *arguments)
    assert words in str(told.error)
    assert list(tmp_path.glob("out/*/")) == [], "no session is left behind"


@pytest.mark.parametrize("arguments", [["--keep-free", "x"], ["--keep-free", "5 parsecs"]])
def test_wrong_usage_is_told(arguments: list[str]) -> None:
    assert arguments[1] in Here().misused("record", *arguments).err
