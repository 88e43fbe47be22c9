"""The store of fetched files: resumed, bounded, deaf to hostile names, and read in chunks by the ground."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

from tests.services.files.disk import PATIENCE_S, Disk, disk, noise, same
from zmav import keys, wire
from zmav.client import Answer
from zmav.errors import BadInput, Refused, ZmavError
from zmav.mavlink.ftp import Nak, Op, crc32
from zmav.services.files.store import META, Store
from zmav.vehicle.files import PART, Files
from zmav.wire.files import CHUNK, MOST_CHUNKS, MOST_PUT

if TYPE_CHECKING:
    from tests.conftest import Net, StartOnboard


async def cut_short(d: Disk, path: str) -> int:
    """Begin to fetch a file and end that after some of it came; gives the bytes that are kept."""
    under_way = asyncio.Event()

    def report(news: dict[str, Any]) -> None:
        if news.get("bytes", 0) > 1000:
            under_way.set()

    task = asyncio.ensure_future(d.onboard.files.fetch(path, report))
    await asyncio.wait_for(under_way.wait(), PATIENCE_S)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    meta = d.onboard.files.store.files[Store.name_of(path)]
    return meta.size - sum(end - start for start, end in meta.missing)


async def fetch(d: Disk, path: str) -> wire.StoredFile:
    return await d.onboard.files.fetch(path, lambda news: None)


async def test_an_interrupted_get_goes_on_where_it_stopped(net: Net, onboard: StartOnboard, tmp_path: Path) -> None:
    async with disk(net, onboard, tmp_path) as d:
        data = d.put("/APM/f", noise(700_000))
        have = await cut_short(d, "/APM/f")
        assert 1000 < have < len(data)
        d.onboard.files.store = Store(d.onboard.files.store.directory)  # as after a restart of the companion
        stored = await fetch(d, "/APM/f")
        assert (stored.resumed, stored.verified, stored.crc32) == (have, True, crc32(data))
        same((await d.v.files.get("/APM/f", tmp_path / "f")).read_bytes(), data)


async def test_what_is_another_file_by_now_is_begun_again(net: Net, onboard: StartOnboard, tmp_path: Path) -> None:
    async with disk(net, onboard, tmp_path) as d:
        d.put("/APM/f", noise(700_000))
        have = await cut_short(d, "/APM/f")
        data = d.put("/APM/f", noise(700_000, seed=2))
        said: list[int] = []
        stored = await d.onboard.files.fetch("/APM/f", lambda news: said.append(news.get("bytes", 0)))
        assert next(filter(None, said)) < have
        assert (stored.resumed, stored.verified) == (0, True)
        same((await d.v.files.get("/APM/f", tmp_path / "f")).read_bytes(), data)


async def test_a_file_that_is_here_already_is_not_fetched_again(
    net: Net, onboard: StartOnboard, tmp_path: Path
) -> None:
    async with disk(net, onboard, tmp_path) as d:
        d.put("/APM/f", noise(5_000))
        assert (await fetch(d, "/APM/f")).by == "ftp"
        d.storage.ftp.faults.refuse[Op.OPEN_FILE_RO] = Nak.FILE_NOT_FOUND
        again = await fetch(d, "/APM/f")
        assert (again.by, again.verified) == ("store", True)
        data = d.put("/APM/f", noise(5_000, seed=2))
        d.storage.ftp.faults.refuse.clear()
        assert (await fetch(d, "/APM/f")).crc32 == crc32(data)


async def test_a_damaged_part_is_noticed_by_the_checksum(net: Net, onboard: StartOnboard, tmp_path: Path) -> None:
    async with disk(net, onboard, tmp_path) as d:
        data = d.put("/APM/f", noise(700_000))
        assert await cut_short(d, "/APM/f") > 0
        path = d.onboard.files.store.directory / Store.name_of("/APM/f")
        with path.open("r+b") as file:
            file.write(b"\xaa" * 100)  # where the first bytes had come already
        stored = await fetch(d, "/APM/f")
        assert (stored.resumed, stored.verified, stored.crc32) == (0, True, crc32(data))


async def test_chunks_are_small_and_a_query_is_bounded(net: Net, onboard: StartOnboard, tmp_path: Path) -> None:
    async with disk(net, onboard, tmp_path) as d:
        size = CHUNK * (MOST_CHUNKS + 10) + 7
        data = d.put("/APM/f", noise(size))
        stored = await fetch(d, "/APM/f")
        key = keys.FILE_CHUNK.key("demo", "quad1", file=stored.file, offset="*")
        replies = await d.ground.ask(key)
        assert len(replies) == MOST_CHUNKS
        for reply in replies:
            assert reply.ok is not None
            offset, payload = int(str(reply.ok.key_expr).rpartition("/")[2]), reply.ok.payload.to_bytes()
            assert payload == data[offset : offset + CHUNK]
        (last,) = await d.ground.ask(key, json.dumps({"offset": size - 7, "length": 999_999_999}).encode())
        assert last.ok is not None
        assert last.ok.payload.to_bytes() == data[-7:]
        assert await d.ground.ask(key, json.dumps({"offset": size}).encode()) == []
        one = keys.FILE_CHUNK.key("demo", "quad1", file=stored.file, offset=5)
        (reply,) = await d.ground.ask(one)
        assert reply.ok is not None
        assert reply.ok.payload.to_bytes() == data[5 : 5 + CHUNK]
        (info,) = await d.ground.ask(keys.FILE.key("demo", "quad1", file="*"))
        assert info.ok is not None
        assert wire.decode(info.ok.payload.to_bytes(), wire.StoredFile, "info").path == "/APM/f"


HOSTILE = [
    ("..", "*", b"", "file"),
    ("passwd", "*", b"", "file"),
    ("%2e%2e%2fpasswd", "0", b"", "file"),
    ("x.meta", "0", b"", "file"),
    ("x", "-1", b"", "offset"),
    ("x", "1e3", b"", "offset"),
    ("x", "*", b'{"offset": -1}', "offset"),
    ("x", "*", b'{"from": 1}', "from"),
    ("x", "*", b"\xff", "query of a file"),
]


async def test_hostile_reads_are_refused(
    net: Net, onboard: StartOnboard, tmp_path: Path, subtests: pytest.Subtests
) -> None:
    async with disk(net, onboard, tmp_path) as d:
        for file, offset, payload, field in HOSTILE:
            with subtests.test(file=file, offset=offset, payload=payload):
                (reply,) = await d.ground.ask(keys.FILE_CHUNK.key("demo", "quad1", file=file, offset=offset), payload)
                assert reply.err is not None
                error = wire.error_from(reply.err.payload.to_bytes())
                assert isinstance(error, BadInput)
                assert error.detail["field"] == field


async def test_the_ground_goes_on_with_its_part(net: Net, onboard: StartOnboard, tmp_path: Path) -> None:
    async with disk(net, onboard, tmp_path) as d:
        data = d.put("/APM/f", noise(300_000))
        part = tmp_path / f"f.{crc32(data):08x}{PART}"
        part.write_bytes(data[:250_000])
        said: list[dict[str, Any]] = []
        same((await d.v.files.get("/APM/f", tmp_path / "f", said.append)).read_bytes(), data)
        here = [news["bytes"] for news in said if news["stage"] == "network"]
        assert here
        assert min(here) > 250_000
        assert not part.exists()


async def test_a_part_with_errors_is_not_taken_for_the_file(net: Net, onboard: StartOnboard, tmp_path: Path) -> None:
    async with disk(net, onboard, tmp_path) as d:
        data = d.put("/APM/f", noise(3_000))
        part = tmp_path / f"f.{crc32(data):08x}{PART}"
        part.write_bytes(b"x" * 1_000)
        with pytest.raises(ZmavError, match="came with errors"):
            await d.v.files.get("/APM/f", tmp_path / "f")
        assert not (tmp_path / "f").exists()
        same((await d.v.files.get("/APM/f", tmp_path / "f")).read_bytes(), data)


async def test_a_download_lands_where_it_is_told_and_nowhere_else(
    net: Net, onboard: StartOnboard, tmp_path: Path
) -> None:
    async with disk(net, onboard, tmp_path / "cache") as d:
        d.put("/APM/.hidden", b"1")
        d.put("/APM/a\\..\\b", b"2")
        out = tmp_path / "out"
        assert await d.v.files.get("/APM/.hidden", f"{out}/") == out / "hidden"
        assert await d.v.files.get("/APM/a\\..\\b", out) == out / "b"
        with pytest.raises(BadInput, match="cannot write"):
            await d.v.files.get("/APM/.hidden", out / "b" / "c")


async def test_what_is_too_large_is_not_written(net: Net, onboard: StartOnboard, tmp_path: Path) -> None:
    async with disk(net, onboard, tmp_path) as d:
        with pytest.raises(BadInput, match="too many to be written at once"):
            await d.v.files.put_bytes(bytes(MOST_PUT + 1), "/APM/u")
        with pytest.raises(BadInput, match="too many to be written at once"):
            await d.v.order("file_put", wire.FilePut(path="/APM/u", data=bytes(MOST_PUT + 1)))
        assert "u" not in [entry.name for entry in await d.v.files.list("/APM")]


# The store alone.


def filled(store: Store, origin: str, data: bytes) -> str:
    async def fill() -> str:
        async with store.open(origin, "", len(data)) as part:
            part.put(0, data)
            assert await part.finish(None)
        return part.name

    return asyncio.run(fill())


def test_the_oldest_makes_room(tmp_path: Path) -> None:
    store = Store(tmp_path, most=1_000)
    names = [filled(store, f"/f{i}", noise(400)) for i in range(4)]
    assert sorted(store.files) == sorted(names[2:])
    assert len(list(tmp_path.iterdir())) == 4
    with pytest.raises(Refused, match="1001 bytes are more than"):
        store.open("/g", "", 1_001)
    assert store.read(names[3], 0, 9_999) == noise(400)
    assert store.read(names[3], 390, 20) == noise(400)[390:]


def test_names_keep_within_the_directory() -> None:
    names = [Store.name_of(path) for path in ("/a/../../etc/passwd", "..", "", "/", "a\0b", "A B.bin", "x" * 500, "é")]
    assert len(set(names)) == len(names)
    for name in names:
        assert keys.FILE.key("demo", "quad1", file=name).count("/") == 4
        assert not set(name) - set("abcdefghijklmnopqrstuvwxyz0123456789._-")
        assert not name.startswith(".")
        assert len(name) < 80


def test_a_broken_note_is_as_good_as_none(tmp_path: Path) -> None:
    name = filled(Store(tmp_path), "/f", b"abc")
    again = Store(tmp_path)
    assert again.read(name, 0, 3) == b"abc"
    (tmp_path / (name + META)).write_bytes(b"{")
    with pytest.raises(BadInput, match="no file"):
        Store(tmp_path).read(name, 0, 3)
    again.remove(name)
    assert list(tmp_path.iterdir()) == []


def test_a_directory_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(Refused, match="cannot keep files"):
        Store(tmp_path / "file" / "sub").open("/f", "", 3)


async def test_an_order_with_a_file_in_it_has_no_place_in_the_class_of_orders(
    net: Net, onboard: StartOnboard, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with disk(net, onboard, tmp_path) as d:
        ask, classes = d.z.ask, list[keys.Qos]()

        async def noting(key: str, payload: bytes, timeout: float, channel: keys.Channel) -> Any:
            classes.append(channel.qos)
            return await ask(key, payload, timeout, channel)

        monkeypatch.setattr(d.z, "ask", noting)
        await d.v.hold()
        assert {*classes} == {keys.Qos.MUST_ARRIVE}
        classes.clear()
        assert (await d.v.files.put_bytes(noise(60_000), "/APM/f"))["verified"]
        assert {*classes} == {keys.Qos.BULK}


@pytest.mark.parametrize("lost", [0, 1], ids=["slow", "lost on the way"])
async def test_a_file_is_sent_again_only_where_the_vehicle_does_not_know_of_it(
    net: Net, onboard: StartOnboard, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lost: int
) -> None:
    async with disk(net, onboard, tmp_path / "cache") as d:
        ask, sizes, unknown = d.z.ask, list[int](), list[Any]()

        async def noting(key: str, payload: bytes, timeout: float, channel: keys.Channel) -> Any:
            sizes.append(len(payload))
            if len(sizes) <= lost:
                return await asyncio.sleep(timeout, [])
            answers = await ask(key, payload, timeout, channel)
            unknown.extend(answer for answer in answers if "no order file_put has come" in str(answer))
            return answers

        monkeypatch.setattr(d.z, "ask", noting)
        d.v.ask_again = 0.1  # the file takes longer: both are quick here
        data = noise(MOST_PUT)
        assert (await d.v.files.put_bytes(data, "/APM/f"))["verified"]
        assert len(sizes) >= 2 + lost and len(unknown) >= lost
        assert sum(size > len(data) for size in sizes) <= 1 + len(unknown)
        assert all(size < 100 or size > len(data) for size in sizes)


class Answering:
    """What a download asks: the first answers come from somebody who makes them up, and then an empty-handed one."""

    def __init__(self, data: bytes) -> None:
        self.data, self.asked, self.ended = data, list[float](), list[list[bool]]()

    async def ask(self, key: str, payload: bytes, timeout: float, channel: keys.Channel, enough: Any) -> list[Answer]:
        self.asked.append(asyncio.get_running_loop().time())
        made_up = [(offset, self.data) for offset in ("abc", "-1", "1e3", "9" * 5000)] + [("0", bytes(CHUNK + 1))]
        told = (made_up, [("5", self.data[5:])], [("0", self.data)])[len(self.asked) - 1]
        answers = [Answer(f"{key.removesuffix('*')}{offset}", chunk) for offset, chunk in told]
        self.ended.append([enough(answer) for answer in answers])
        return answers


async def test_who_makes_up_chunks_ends_no_download_and_has_it_ask_no_oftener(tmp_path: Path) -> None:
    data, vehicle = b"0123456789", SimpleNamespace(fleet="demo", name="quad1")
    client = Answering(data)
    stored = wire.StoredFile(file="x", path="/x", size=len(data), crc32=crc32(data), t=0.0)
    files = Files(vehicle, client)  # type: ignore[arg-type]
    assert (await files.download(stored, tmp_path, "x", None)).read_bytes() == data
    assert client.ended == [[False] * 5, [True], [True]]
    first, second, third = client.asked
    assert min(second - first, third - second) > 0.1
