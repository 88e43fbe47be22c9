"""MAVFTP beside the autopilot: every operation, over good links and bad ones, against the simulator's server."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from tests.packed_params import unpack_params
from tests.services.files.disk import PATIENCE_S, disk, noise, same
from zmav import wire
from zmav.errors import BadInput, Refused, TimedOut
from zmav.mavlink import ftp, load_dialect, plan_file
from zmav.mavlink.ftp import Nak, Op, check_written
from zmav.mavlink.packed_params import PATH
from zmav.services.files.ftp_requests import Talk

if TYPE_CHECKING:
    from tests.conftest import Net, StartOnboard


async def test_a_file_there_and_back_and_all_that_can_be_done_with_it(
    net: Net, onboard: StartOnboard, tmp_path: Path
) -> None:
    async with disk(net, onboard, tmp_path) as d:
        files, data = d.v.files, noise(20_011)
        await files.mkdir("/APM/new")
        result = await files.put_bytes(data, "/APM/new/a.bin")
        assert (result["size"], result["verified"]) == (len(data), True)
        same(d.there("/APM/new/a.bin"), data)
        target = await files.get("/APM/new/a.bin", tmp_path / "here.bin")
        assert target == tmp_path / "here.bin"
        same(target.read_bytes(), data)
        (entry,) = await files.list("/APM/new/")
        assert (entry.name, entry.size, entry.directory) == ("a.bin", len(data), False)
        with pytest.raises(Refused, match="not empty"):
            await files.rmdir("/APM/new")
        await files.remove("/APM/new/a.bin")
        await files.rmdir("/APM/new")
        assert [e.name for e in await files.list("/APM")] == ["LOGS", "scripts", "terrain"]
        assert d.idle


async def test_long_listings_come_in_pieces_and_an_empty_one_is_empty(
    net: Net, onboard: StartOnboard, tmp_path: Path
) -> None:
    async with disk(net, onboard, tmp_path) as d:
        assert await d.v.files.list("/APM/terrain") == []
        names = [f"a-name-of-some-length-{i:03d}.dat" for i in range(60)]
        for name in names:
            d.put(f"/APM/terrain/{name}", b"x")
        assert [e.name for e in await d.v.files.list("/APM/terrain")] == names


async def test_sizes_at_the_edges(net: Net, onboard: StartOnboard, tmp_path: Path, subtests: pytest.Subtests) -> None:
    async with disk(net, onboard, tmp_path) as d:
        for size in (0, 1, 239, 240, 478, 239 * 500, 239 * 500 + 1):
            with subtests.test(size=size):
                data = d.put(f"/APM/f{size}", noise(size))
                same((await d.v.files.get(f"/APM/f{size}", tmp_path / f"f{size}")).read_bytes(), data)
                await d.v.files.put_bytes(data, f"/APM/g{size}")
                same(d.there(f"/APM/g{size}"), data)


async def test_what_the_server_refuses_is_said_in_words(net: Net, onboard: StartOnboard, tmp_path: Path) -> None:
    async with disk(net, onboard, tmp_path) as d:
        with pytest.raises(Refused, match="/nope: there is no such file or directory") as caught:
            await d.v.files.list("/nope")
        assert caught.value.detail["nak"] == "FILE_NOT_FOUND"
        with pytest.raises(Refused, match="exists already"):
            await d.v.files.mkdir("/APM")
        d.storage.ftp.faults.refuse[Op.CREATE_FILE] = Nak.FILE_PROTECTED
        with pytest.raises(Refused, match="write-protected"):
            await d.v.files.put_bytes(b"x", "/APM/x")
        for path in ("", "a\0b", "x" * 239):
            with pytest.raises(BadInput, match="cannot be a path"):
                await d.v.files.remove(path)


async def test_plans_and_parameters_are_not_written_past_their_judges(
    net: Net, onboard: StartOnboard, tmp_path: Path
) -> None:
    async with disk(net, onboard, tmp_path) as d:
        item = {"command": 16, "frame": 3, "x": 900000000, "y": 0, "z": 5000.0}
        data = plan_file.pack_header(0, 2) + 2 * plan_file.pack_item(item, load_dialect())
        for path in ("@MISSION/mission.dat", "/@MISSION/mission.dat", "@PARAM/param.pck"):
            with pytest.raises(BadInput, match="no file on the autopilot's disk: mission_upload writes plans"):
                await d.v.files.put_bytes(data, path)
        with pytest.raises(BadInput, match="where an autopilot keeps plans or parameters: mission_upload writes plans"):
            await d.v.files.remove("/fs/microsd/dataman")
        assert len(d.world.vehicles[0].copter.mission) <= 1  # home
        assert (await d.v.files.get("@MISSION/mission.dat", tmp_path)).read_bytes()[:2] == data[:2]  # it can be read


@pytest.mark.parametrize(
    "path",
    [
        "/fs/microsd/dataman",
        "/fs/microsd/params",
        "/fs/microsd/parameters_backup.bson",
        "/fs/mtd_params",
        "/fs/mtd_waypoints",
        "fs//microsd/./dataman",
        "/fs/microsd//DATAMAN",
        "/../rootfs/dataman",
        "/APM/ArduCopter.stg",
        "/APM/mission.stg",
        "/APM/STRG_BAK/x.bin",
        "eeprom.bin",
        "/dataman",
        "./parameters.bson",
        "/eeprom/parameters",
        "./@MISSION/mission.dat",
        "@PARAM/../x",
    ],
)
def test_nothing_is_written_where_an_autopilot_keeps_plans_and_parameters(path: str) -> None:
    """Neither by its usual name nor by another, whatever the autopilot is."""
    with pytest.raises(BadInput, match="mission_upload writes plans"):
        check_written(path)


@pytest.mark.parametrize("path", ["/APM/a.lua", "/fs/microsd/log/x.ulg", "/fs/microsd/etc/extras.txt", "@ROMFS/x"])
def test_other_files_are_written(path: str) -> None:
    check_written(path)


async def test_a_bad_link_costs_time_and_nothing_else(net: Net, onboard: StartOnboard, tmp_path: Path) -> None:
    async with disk(net, onboard, tmp_path, "lossy:{}?loss=0.2&delay=0.02&seed=5") as d:
        data = d.put("/APM/f", noise(12_000))
        same((await d.v.files.get("/APM/f", tmp_path / "f")).read_bytes(), data)
        result = await d.v.files.put_bytes(data[:2_000], "/APM/g")
        assert result["verified"]
        same(d.there("/APM/g"), data[:2_000])
        assert d.idle


async def test_a_server_that_cannot_burst_is_read_piece_by_piece(
    net: Net, onboard: StartOnboard, tmp_path: Path
) -> None:
    async with disk(net, onboard, tmp_path) as d:
        data = d.put("/APM/f", noise(20_000))
        d.storage.ftp.faults.refuse[Op.BURST_READ_FILE] = Nak.UNKNOWN_COMMAND
        same((await d.v.files.get("/APM/f", tmp_path / "f")).read_bytes(), data)


async def test_without_a_checksum_a_file_comes_all_the_same(net: Net, onboard: StartOnboard, tmp_path: Path) -> None:
    async with disk(net, onboard, tmp_path) as d:
        data = d.put("/APM/f", noise(2_000))
        d.storage.ftp.faults.refuse[Op.CALC_FILE_CRC32] = Nak.UNKNOWN_COMMAND
        stored = await d.onboard.files.fetch("/APM/f", lambda news: None)
        assert (stored.verified, stored.crc32, stored.size) == (False, ftp.crc32(data), 2_000)
        assert not (await d.v.files.put_bytes(data, "/APM/g"))["verified"]


async def test_parameters_as_a_file(net: Net, onboard: StartOnboard, tmp_path: Path) -> None:
    async with disk(net, onboard, tmp_path) as d:
        d.storage.ftp.faults.refuse[Op.CALC_FILE_CRC32] = Nak.FILE_PROTECTED  # a real one's is of other reads than ours
        found = unpack_params((await d.v.files.get(PATH, tmp_path)).read_bytes())
        params = d.world.vehicles[0].copter.params
        assert [p.name for p in found] == params.names
        assert {p.name: p.value for p in found} == {name: params[name] for name in params.names}


async def test_a_cancelled_transfer_closes_its_session(net: Net, onboard: StartOnboard, tmp_path: Path) -> None:
    async with disk(net, onboard, tmp_path) as d:
        d.put("/APM/f", noise(2_000_000))
        under_way = asyncio.Event()

        def progress(news: dict[str, Any]) -> None:
            if news.get("bytes"):
                under_way.set()

        task = asyncio.ensure_future(d.v.files.get("/APM/f", tmp_path / "f", progress))
        await asyncio.wait_for(under_way.wait(), PATIENCE_S)
        assert not d.idle
        assert await d.v.files.cancel() == "getting /APM/f"
        with pytest.raises(Refused, match="superseded"):
            await task
        assert d.idle
        assert await d.v.files.cancel() is None


async def test_what_is_cancelled_is_the_transfer_under_way_and_none_that_waits(
    net: Net, onboard: StartOnboard, tmp_path: Path
) -> None:
    async with disk(net, onboard, tmp_path) as d:
        d.put("/APM/f", noise(2_000_000))
        other = d.put("/APM/g", noise(2_000))
        under_way, waits = asyncio.Event(), asyncio.Event()
        first = asyncio.ensure_future(
            d.v.files.get("/APM/f", tmp_path / "f", lambda news: under_way.set() if news.get("bytes") else None)
        )
        await asyncio.wait_for(under_way.wait(), PATIENCE_S)
        second = asyncio.ensure_future(
            d.v.files.get("/APM/g", tmp_path / "g", lambda news: waits.set() if news.get("waiting_for") else None)
        )
        await asyncio.wait_for(waits.wait(), PATIENCE_S)
        assert await d.v.files.cancel() == "getting /APM/f"
        with pytest.raises(Refused, match="superseded"):
            await first
        same((await second).read_bytes(), other)


async def test_a_transfer_that_waits_for_what_is_none_is_cancelled(
    net: Net, onboard: StartOnboard, tmp_path: Path
) -> None:
    async with disk(net, onboard, tmp_path) as d:
        waits = asyncio.Event()
        d.put("/APM/g", noise(2_000))
        async with d.onboard.files.ftp.turn("getting @MISSION/mission.dat", lambda news: None):
            waiting = asyncio.ensure_future(
                d.v.files.get("/APM/g", tmp_path / "g", lambda news: waits.set() if news.get("waiting_for") else None)
            )
            await asyncio.wait_for(waits.wait(), PATIENCE_S)
            assert await d.v.files.cancel() == "a transfer"
            with pytest.raises(Refused, match="superseded"):
                await waiting
            assert await d.v.files.cancel() is None
        assert d.onboard.files.ftp.idle


async def test_who_waits_for_a_turn_has_it_next(net: Net, onboard: StartOnboard, tmp_path: Path) -> None:
    """Between two turns nobody has one, and yet nobody else could have it at once."""
    async with disk(net, onboard, tmp_path) as d:
        ftp, waits = d.onboard.files.ftp, asyncio.Event()

        async def second() -> None:
            async with ftp.turn("second", lambda news: waits.set()):
                pass

        assert ftp.idle
        async with ftp.turn("first", lambda news: None):
            assert not ftp.idle
            waiting = asyncio.ensure_future(second())
            await waits.wait()
        assert (ftp.under_way, ftp.idle) == ((None, ""), False)
        await waiting
        assert ftp.idle


async def test_a_put_is_cancelled_while_its_checksum_is_asked_for_too(
    net: Net, onboard: StartOnboard, tmp_path: Path
) -> None:
    async with disk(net, onboard, tmp_path) as d:
        d.storage.ftp.faults.mute.add(Op.CALC_FILE_CRC32)  # so that it is still asked for when the other order comes
        files, ending = d.onboard.files, list[asyncio.Future[dict[str, Any]]]()

        def report(news: dict[str, Any]) -> None:
            if news.get("checking"):
                ending.append(asyncio.ensure_future(files.cancel(wire.Order(), lambda news: None)))

        with pytest.raises(asyncio.CancelledError):
            await files.put(wire.FilePut(path="/APM/u", data=b"1"), report)
        assert await ending[0] == {"cancelled": "checking /APM/u"}


async def test_an_order_that_is_cancelled_more_than_once_leaves_no_transfer_behind(
    net: Net, onboard: StartOnboard, tmp_path: Path
) -> None:
    """Else the next one could not be cancelled before its first turn."""
    async with disk(net, onboard, tmp_path) as d:
        files, under_way = d.onboard.files, asyncio.Event()

        async def work() -> None:
            under_way.set()
            await asyncio.Event().wait()

        first = asyncio.ensure_future(files.transfer(work()))
        await under_way.wait()
        while not first.done():
            first.cancel()
            await asyncio.sleep(0)
        under_way.clear()
        second = asyncio.ensure_future(files.transfer(work()))
        await under_way.wait()
        assert await files.cancel(wire.Order(), lambda news: None) == {"cancelled": "a transfer"}
        with pytest.raises(asyncio.CancelledError):
            await second


async def test_half_a_file_is_not_left_behind(net: Net, onboard: StartOnboard, tmp_path: Path) -> None:
    async with disk(net, onboard, tmp_path) as d:
        d.storage.ftp.faults.refuse[Op.WRITE_FILE] = Nak.FAIL
        with pytest.raises(Refused, match="at byte 0"):
            await d.v.files.put_bytes(noise(5_000), "/APM/scripts/x.lua")
        assert await d.v.files.list("/APM/scripts") == []


async def test_one_transfer_at_a_time_and_who_waits_is_told_for_what(
    net: Net, onboard: StartOnboard, tmp_path: Path
) -> None:
    async with disk(net, onboard, tmp_path) as d:
        data = d.put("/APM/f", noise(600_000))
        said: list[dict[str, Any]] = []
        first = asyncio.ensure_future(d.onboard.files.fetch("/APM/f", said.append))
        while not any("bytes" in news for news in said):
            await asyncio.sleep(0.01)
        waited: list[dict[str, Any]] = []
        await d.onboard.files.ftp.list("/APM", waited.append)
        assert waited[:2] == [{"waiting_for": "getting /APM/f"}, {"waiting_for": None}]
        assert (await first).size == len(data)


async def test_another_clients_session_is_waited_for_and_respected(
    net: Net, onboard: StartOnboard, tmp_path: Path
) -> None:
    async with disk(net, onboard, tmp_path, speed=4.0) as d:
        data = d.put("/APM/f", noise(1_000))
        address = d.onboard.adapter.address
        source = d.onboard.identity.source
        assert source is not None
        with Talk(d.onboard.adapter, source, session=7) as other:
            assert (await other.ask(Op.OPEN_FILE_RO, b"/APM/f")).nak is None
            assert (await other.ask(Op.READ_FILE, offset=0, size=10)).data == data[:10]
            assert address[1] != 7
        # Three simulated seconds later the server takes it for gone.
        same((await d.v.files.get("/APM/f", tmp_path / "f")).read_bytes(), data)


async def test_sequence_numbers_go_round(net: Net, onboard: StartOnboard, tmp_path: Path) -> None:
    async with disk(net, onboard, tmp_path) as d:
        source = d.onboard.identity.source
        assert source is not None
        with Talk(d.onboard.adapter, source, session=9) as talk:
            talk.skip(0xFFFD, 0)
            for _ in range(5):
                assert (await talk.ask(Op.NONE)).opcode == Op.ACK
            assert (await talk.ask(Op.LIST_DIRECTORY, b"/", offset=0)).seq == 4


async def test_a_server_that_never_answers_is_given_up(
    net: Net, onboard: StartOnboard, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Talk.ask, "__kwdefaults__", {**Talk.ask.__kwdefaults__, "give_up": 0.5})  # type: ignore[dict-item]
    async with disk(net, onboard, tmp_path) as d:
        d.storage.ftp.faults.mute.update(Op)
        with pytest.raises(TimedOut, match="has no MAVFTP"):
            await d.onboard.files.ftp.list("/", lambda news: None)
