"""What is in the files: exact frames, decoded fields, all of it whatever happens to the disk or the process."""

from __future__ import annotations

import errno
import json
import os
import resource
import shutil
import struct
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from mcap.reader import make_reader
from pymavlink import mavutil

from ground.record import mcapfile, schemas
from ground.record.folder import is_whole
from ground.record.mcapfile import repair
from ground.record.part import MOST_TLOGS
from tests.ground.record.conftest import read, read_cut, records
from zmav import wire
from zmav.errors import BadConfig, BadInput
from zmav.links.tlog import TlogReader

if TYPE_CHECKING:
    from tests.ground.record.conftest import Frames, Room

QUAD1 = "zmav/demo/quad1"
STATE = wire.encode(
    wire.VehicleState(
        t=1700000000.5,
        fleet="demo",
        name="quad1",
        instance="i",
        position=wire.GlobalPosition(lat_deg=1.0, lon_deg=2.0, alt_amsl=3.0, alt_rel=0.0),
    )
)


def tlog(path: Path) -> list[bytes]:
    with path.open("rb") as file:
        reader = TlogReader(file)
        found = [frame for _, frame in reader]
        assert reader.skipped == 0
        return found


def test_frames_are_kept_byte_for_byte_and_decoded(bench: Any, frames: type[Frames]) -> None:
    here, make = bench(), frames()
    for number in range(50):
        here.storage.put(f"{QUAD1}/{make.key}", make(), at=(1_700_000_000_000 + number) * 1_000_000)
    here.storage.close()
    (path,) = here.files("tlog")
    assert path.name == "quad1.001.tlog"
    assert path.read_bytes() == b"".join(
        struct.pack(">Q", 1_700_000_000_000_000 + 1000 * n) + frame for n, frame in enumerate(make.made)
    )
    theirs = mavutil.mavlink_connection(str(path))
    assert [theirs.recv_match().time_boot_ms for _ in range(50)] == list(range(50))
    assert theirs.recv_match() is None

    (path,) = here.files("mcap")
    assert read(path, schemas.ALL_FRAMES) == [(f"{QUAD1}/mav/rx", frame) for frame in make.made]
    decoded = read(path, schemas.DECODED)
    assert {topic for topic, _ in decoded} == {f"{QUAD1}/mav/rx/1/1/ATTITUDE"}
    assert [json.loads(data)["time_boot_ms"] for _, data in decoded] == list(range(50))
    assert here.storage.counts.written == 50


def test_documents_are_kept_as_they_came_with_what_foxglove_wants(bench: Any) -> None:
    here = bench()
    event = wire.encode(wire.Event(t=1700000001.0, kind="mode", severity="info", text="GUIDED"))
    goal = b'{"quad1": [1, 2, 3]}'
    came = [(f"{QUAD1}/state", STATE), (f"{QUAD1}/event", event), ("zmav/demo/@fleet/goal", goal)]
    for key, data in [*came, (f"{QUAD1}/state", b"no JSON"), (f"{QUAD1}/link/x", b"[1]")]:
        here.storage.put(key, data, at=1_700_000_005_000_000_000)
    here.storage.close()
    assert here.files("tlog") == [], "no frame came"
    (path,) = here.files("mcap")
    kept = [*came, (f"{QUAD1}/state/bytes", b"no JSON"), (f"{QUAD1}/link/x/bytes", b"[1]")]
    assert read(path, schemas.AS_IT_CAME) == kept
    made = dict(read(path, schemas.DERIVED))
    assert json.loads(made[f"{QUAD1}/location"])["latitude"] == 1.0
    times = [(m.log_time, m.publish_time) for m in records(path) if type(m).__name__ == "Message"]
    assert times[0] == (1_700_000_005_000_000_000, 1_700_000_000_500_000_000)


def test_what_is_no_frame_or_not_recorded_spoils_nothing(bench: Any, frames: type[Frames]) -> None:
    here, make = bench(), frames()
    for key, data in (
        (make.key, make()),
        (make.key, b"\xfd\x01"),
        (make.key, b""),
        ("param/X", b"{}"),
        ("nonsense/at/all", b"{}"),
        ("mav/rx/300/1/ATTITUDE", make()),
        ("mav/rx/x/1/ATTITUDE", make()),
        ("mav/tx/1/1/ATTITUDE", make()),
    ):
        here.storage.put(f"{QUAD1}/{key}", data)
    here.storage.close()
    assert here.storage.counts.refused == 4
    assert tlog(here.files("tlog")[0]) == make.made
    (path,) = here.files("mcap")
    rx, tx = f"{QUAD1}/mav/rx", f"{QUAD1}/mav/tx"
    assert read(path, schemas.ALL_FRAMES) == [*((rx, frame) for frame in make.made[:3]), (tx, make.made[3])]


def test_files_are_complete_in_themselves_at_every_split(bench: Any, frames: type[Frames]) -> None:
    here, make = bench(split_size=4000), frames()
    for part in range(1, 4):
        for _ in range(200):
            here.storage.put(f"{QUAD1}/{make.key}", make())
        here.until("written", 200 * part)
    here.storage.close()
    names = [path.name for path in here.files("mcap")]
    assert len(names) >= 3
    assert names == [f"record.{n:03}.mcap" for n in range(1, len(names) + 1)]
    kept = [frame for path in here.files("mcap") for _, frame in read(path, schemas.ALL_FRAMES)]
    assert kept == make.made
    assert [frame for path in here.files("tlog") for frame in tlog(path)] == make.made
    assert here.storage.counts.bytes == sum(path.stat().st_size for path in here.storage.session.iterdir())


def test_the_floor_of_free_room_is_kept(bench: Any, folder: Room, frames: type[Frames]) -> None:
    folder.room = 2000
    here, make = bench(keep_free=1000), frames()
    here.storage.put(f"{QUAD1}/{make.key}", make())
    here.until("written", 1)
    folder.room = 999
    here.told("999 B free on the disk, and 1.0 kB are to be kept")
    assert here.storage.paused
    here.storage.put(f"{QUAD1}/{make.key}", make())
    here.until("unwritten", 1)
    folder.room = 1001
    here.storage.put(f"{QUAD1}/{make.key}", make())
    here.until("unwritten", 2)  # or it would be off and on with every sample
    folder.room = 2000
    while here.storage.counts.parts < 2:
        here.storage.put(f"{QUAD1}/{make.key}", make())
        here.until("taken", len(make.made))
    here.told("there is room again")
    here.storage.close()
    assert here.storage.paused is None
    first, second = here.files("tlog")
    assert tlog(first) == make.made[:1]
    assert tlog(second) == make.made[-here.storage.counts.written + 1 :]


@pytest.fixture
def narrow() -> Iterator[Any]:
    """Limit how large any file of this process may become: as a full disk, it takes a part of what is written."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    yield lambda size: resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_costs_what_does_not_fit_and_nothing_else(
    bench: Any,
    frames: type[Frames],
    narrow: Any,
) -> None:
    here, make = bench(retry=0.2), frames()
    for _ in range(100):
        here.storage.put(f"{QUAD1}/{make.key}", make())
    here.until("written", 100)
    narrow(max(path.stat().st_size for path in here.storage.session.iterdir()) + 3000)
    for _ in range(1000):
        here.storage.put(f"{QUAD1}/{make.key}", make())
    here.told("the disk is full: nothing is recorded until there is room")
    (cut,) = here.files("mcap")[:1]
    assert not is_whole(cut)
    assert [frame for _, frame in read_cut(cut, schemas.ALL_FRAMES)] == make.made[:100]
    written = here.storage.counts.written
    narrow(resource.RLIM_INFINITY)
    while not any("there is room again" in line for line in here.said):
        here.storage.put(f"{QUAD1}/{make.key}", make())
        here.until("taken", len(make.made))
    here.storage.close()
    counts = here.storage.counts
    assert counts.written > written
    assert counts.written + counts.unwritten == counts.taken == len(make.made)
    assert repair(cut).messages == 200
    assert [frame for _, frame in read(cut, schemas.ALL_FRAMES)] == make.made[:100]
    last = read(here.files("mcap")[-1], schemas.ALL_FRAMES)
    assert last[-1][1] == make.made[-1]
    assert tlog(here.files("tlog")[0])[:100] == make.made[:100]


def test_a_disk_that_has_become_read_only_is_said_and_tried_again(
    bench: Any, frames: type[Frames], narrow: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Any, **options: Any) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    here, make = bench(retry=0.2), frames()
    narrow(1000)  # the .mcap begins, and the .tlog takes nothing
    with monkeypatch.context() as read_only:
        read_only.setattr(os, "unlink", refuse)
        for _ in range(100):
            here.storage.put(f"{QUAD1}/{make.key}", make())
        here.told("nothing is recorded until there is room")
    narrow(resource.RLIM_INFINITY)
    while not any("there is room again" in line for line in here.said):
        here.storage.put(f"{QUAD1}/{make.key}", make())
        here.until("taken", len(make.made))
    here.storage.close()
    assert tlog(here.files("tlog")[-1])[-1] == make.made[-1]


def test_a_file_cut_anywhere_is_completed_to_its_last_flush(bench: Any, frames: type[Frames], tmp_path: Path) -> None:
    here, make = bench(), frames()
    for flushed in (20, 40, 60):
        while len(make.made) < flushed:
            here.storage.put(f"{QUAD1}/{make.key}", make())
        here.until("written", flushed)
    here.storage.close()
    whole = here.files("mcap")[0].read_bytes()
    path, kept = tmp_path / "cut.mcap", []
    for size in (*range(8, len(whole), max(1, len(whole) // 20)), len(whole) - 1):
        path.write_bytes(whole[:size])
        expected = read_cut(path, schemas.ALL_FRAMES)
        done = repair(path)
        assert not done.whole
        assert is_whole(path)
        found = read(path, schemas.ALL_FRAMES)
        assert found == expected
        kept.append(len(found))
        with path.open("rb") as file:
            summary = make_reader(file).get_summary()
            assert summary is not None
            assert summary.statistics is not None
            assert summary.statistics.message_count == 2 * len(found) == done.messages
        assert [each.data for each in mcapfile.read_forth(path) if each.holds == schemas.ALL_FRAMES] == [
            frame for _, frame in found
        ]
        assert repair(path).whole
    assert kept == sorted(kept)
    assert {0, 20, 40, 60} <= set(kept)


@pytest.mark.parametrize("content", [b"", b"no recording", b"\x89MCAP0\r\n"[:7]])
def test_what_is_no_mcap_is_not_touched(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    with pytest.raises(BadInput, match=r"no \.mcap"):
        repair(path)
    assert path.read_bytes() == content


def test_a_damaged_middle_ends_the_recording_there(bench: Any, frames: type[Frames]) -> None:
    here, make = bench(), frames()
    sizes = []
    for flushed in (20, 40):
        while len(make.made) < flushed:
            here.storage.put(f"{QUAD1}/{make.key}", make())
        here.until("written", flushed)
        sizes.append(here.files("mcap")[0].stat().st_size)
    here.storage.close()
    (path,) = here.files("mcap")
    data = bytearray(path.read_bytes())
    data[sum(sizes) // 2 - 200] ^= 0xFF
    path.write_bytes(data[:-8])
    repair(path)
    assert [frame for _, frame in read(path, schemas.ALL_FRAMES)] == make.made[:20]


def test_two_recorders_never_share_a_folder(folder: Room) -> None:
    from ground.record.folder import Folder

    with pytest.raises(BadConfig, match=rf"another recorder \(process {os.getpid()}\) writes to .*--out"):
        Folder(folder.path)
    first, second = folder.session(), folder.session()
    assert first != second
    folder.close()
    with Folder(folder.path) as again:
        assert again.unfinished == []


def test_where_nobody_can_write_is_told(tmp_path: Path) -> None:
    from ground.record.folder import Folder

    (tmp_path / "file").write_text("")
    with pytest.raises(BadConfig, match="cannot record to"):
        Folder(tmp_path / "file" / "x")


@pytest.mark.parametrize("whole", [True, False], ids=["the folder of all", "the session's"])
def test_files_that_are_taken_away_are_begun_again(bench: Any, folder: Room, frames: type[Frames], whole: bool) -> None:
    here, make = bench(), frames()
    here.storage.put(f"{QUAD1}/{make.key}", make())
    here.until("written", 1)
    shutil.rmtree(folder.path if whole else here.storage.session)
    here.told("new ones are begun")
    here.storage.put(f"{QUAD1}/{make.key}", make())
    here.until("written", 2)
    here.storage.close()
    assert tlog(here.files("tlog")[0]) == make.made[1:]
    assert [path.name for path in here.files("mcap")] == ["record.002.mcap"]


def test_a_disk_that_takes_nothing_is_said_and_what_it_refuses_stops_the_recording(
    bench: Any, frames: type[Frames], monkeypatch: pytest.MonkeyPatch
) -> None:
    free, refusing = threading.Event(), threading.Event()

    def stuck(descriptor: int) -> None:
        free.wait(30.0)
        if refusing.is_set():
            raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(os, "fdatasync", stuck)
    here, make = bench(sync=0.2, slow=0.5), frames()
    here.storage.put(f"{QUAD1}/{make.key}", make())
    here.told("the disk has taken nothing")
    here.storage.put(f"{QUAD1}/{make.key}", make())
    here.until("written", 2)
    refusing.set()
    free.set()
    here.told("Input/output error: nothing is recorded")
    refusing.clear()


def test_a_name_too_long_for_a_file_stops_nobody_elses(bench: Any, frames: type[Frames]) -> None:
    here, make = bench(), frames()
    for name in ("quad1", "q" * 300, "quad1"):
        here.storage.put(f"zmav/demo/{name}/{make.key}", make())
    here.storage.close()
    assert here.storage.counts.written == 3
    assert [path.name for path in here.files("tlog")] == ["quad1.001.tlog"]
    assert len(read(here.files("mcap")[0], schemas.ALL_FRAMES)) == 3


def test_a_file_that_is_being_written_is_not_mended(bench: Any, frames: type[Frames]) -> None:
    here, make = bench(), frames()
    here.storage.put(f"{QUAD1}/{make.key}", make())
    here.until("written", 1)
    (path,) = here.files("mcap")
    with pytest.raises(OSError, match="a recorder still writes it"):
        repair(path)
    here.storage.put(f"{QUAD1}/{make.key}", make())
    here.storage.close()
    assert [frame for _, frame in read(path, schemas.ALL_FRAMES)] == make.made


def test_a_clock_that_is_set_back_changes_no_order(bench: Any, frames: type[Frames]) -> None:
    here, make = bench(), frames()
    times = [1_700_000_000_000_000_000 + second * 10**9 for second in (100, 101, 50, 51)]
    for at in times:
        here.storage.put(f"{QUAD1}/{make.key}", make(), at=at)
    here.until("written", 4)
    here.storage.close()
    (path,) = here.files("mcap")
    played = [found.data for found in mcapfile.read_forth(path) if found.holds == schemas.ALL_FRAMES]
    assert played == make.made


def test_names_without_end_fill_no_memory(bench: Any, frames: type[Frames]) -> None:
    here, make = bench(most_routes=MOST_TLOGS + 10), frames()
    for number in range(MOST_TLOGS + 20):
        here.storage.put(f"zmav/demo/quad{number}/{make.key}", make())
    here.storage.close()
    assert here.storage.counts.refused == 10
    assert len(here.files("tlog")) == MOST_TLOGS


def test_a_full_queue_counts_what_it_leaves_out(
    bench: Any,
    frames: type[Frames],
) -> None:
    here, make = bench(queue=5, poll=60.0), frames()
    here.until("taken", 0)
    for _ in range(9):
        here.storage.put(f"{QUAD1}/{make.key}", make())
    here.storage.close()
    assert (here.storage.counts.dropped, here.storage.counts.written) == (4, 5)


def test_what_waits_is_bounded_in_bytes_too(bench: Any) -> None:
    here = bench(queue_bytes=1000, poll=60.0)
    for _ in range(5):
        here.storage.put(f"{QUAD1}/link/x", json.dumps({"x": "y" * 600}).encode())
    here.storage.close()
    assert (here.storage.counts.dropped, here.storage.counts.written) == (3, 2)


def test_a_file_that_was_cut_short_waits_for_room_to_write_it_twice(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    from ground.record.cli import complete
    from ground.record.folder import MAGIC, Folder

    cut = tmp_path / "2026-01-01_00-00-00" / "record.001.mcap"
    cut.parent.mkdir()
    cut.write_bytes(MAGIC + b"x" * 100)
    with Folder(tmp_path) as folder:
        assert folder.unfinished == [cut]
        complete(folder, 1 << 60)
    said = capfd.readouterr()
    assert "not completed, for want of room" in said.out + said.err
    assert cut.read_bytes() == MAGIC + b"x" * 100
