"""What an autopilot is told of the ground, grid by grid, and what it is not told."""

from __future__ import annotations

import array
import base64
import math
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from zmav import keys, wire
from zmav.errors import BadInput
from zmav.services.terrain.requests import NEEDS, Block
from zmav.terrain import Piece, corner_of, names_within, pack

if TYPE_CHECKING:
    from tests.services.conftest import Bench, Peer, StartBench

CORNER = (-353710000, 1491510000)
SPACING = 100
SET_INTERVAL = 511
PLACE = (-35.363262, 149.165237)


Started = Callable[[], Awaitable["Bench"]]


@pytest.fixture
async def started(bench: StartBench, tmp_path: Path) -> Started:
    """A vehicle that keeps its pieces in a folder of the test's own."""

    async def start() -> Bench:
        return await (await bench(settings={"cache": str(tmp_path)})).connected()

    return start


def level(lat: float, lon: float) -> float:
    """A plane: 1 m up in a thousandth of a degree to the north, 2 m to the east."""
    return 500.0 + 1000.0 * (lat + 36.0) + 2000.0 * (lon - 149.0)


def ground(south: float, west: float, north: float, east: float) -> dict[str, Piece]:
    found = {}
    for name in names_within(south, west, north, east):
        row, column = corner_of(name)
        side = 61
        heights = array.array(
            "h",
            (round(level((row + 1 - r / 60) / 60, (column + c / 60) / 60)) for r in range(side) for c in range(side)),
        )
        found[name] = Piece(side, heights)
    return found


def ask(peer: Peer, mask: int, corner: tuple[int, int] = CORNER, spacing: int = SPACING) -> None:
    peer.send("TERRAIN_REQUEST", lat=corner[0], lon=corner[1], grid_spacing=spacing, mask=mask)


async def report(b: Bench) -> wire.TerrainReport:
    (reply,) = await b.ground.ask(keys.TERRAIN.key("demo", "quad1"))
    assert reply.ok is not None
    return wire.decode(reply.ok.payload.to_bytes(), wire.TerrainReport, "terrain")


def packed(pieces: dict[str, Piece]) -> dict[str, str]:
    return {name: base64.b64encode(pack(piece)).decode() for name, piece in pieces.items()}


async def put(b: Bench, pieces: dict[str, Piece]) -> dict[str, Any]:
    done = await b.ground.do("terrain_put", pieces=packed(pieces))
    return dict(done.result or {})


async def test_each_grid_that_is_asked_for_is_answered_with_the_ground_there(started: Started) -> None:
    b = await started()
    await put(b, ground(-35.38, 149.14, -35.33, 149.20))
    ask(b.peer, (1 << 56) - 1)
    await b.peer.count("TERRAIN_DATA", 56)
    told = b.peer.heard("TERRAIN_DATA", lat=CORNER[0], lon=CORNER[1], grid_spacing=SPACING)
    assert sorted(t.fields["gridbit"] for t in told) == list(range(56))
    across = 111319.5 * math.cos(math.radians(35.36))
    for t in told:
        row, column = divmod(t.fields["gridbit"], 8)
        for i, height in enumerate(t.fields["data"]):
            north, east = (4 * row + i // 4) * SPACING, (4 * column + i % 4) * SPACING
            expected = level(CORNER[0] / 1e7 + north / 111319.5, CORNER[1] / 1e7 + east / across)
            assert height == pytest.approx(expected, abs=1.1), (t.fields["gridbit"], i)
    b.peer.told.clear()
    ask(b.peer, 1 << 9 | 1 << 55)
    await b.peer.count("TERRAIN_DATA", 2)
    assert [t.fields["gridbit"] for t in b.peer.heard("TERRAIN_DATA")] == [9, 55]
    b.peer.send("TERRAIN_REPORT", pending=3, loaded=501)
    b.peer.send("GLOBAL_POSITION_INT", lat=round(PLACE[0] * 1e7), lon=round(PLACE[1] * 1e7), alt=1500000)
    ask(b.peer, 1)
    await b.peer.count("TERRAIN_DATA", 3)
    seen = await report(b)
    assert (seen.answered, seen.pending, seen.loaded, seen.missing) == (59, 3, 501, [])
    assert seen.height == pytest.approx(level(*PLACE), abs=1.0)
    assert seen.above == pytest.approx(1500.0 - level(*PLACE), abs=1.0)


async def test_ground_that_is_not_there_is_named_once_and_answered_when_it_comes(started: Started) -> None:
    b = await started()
    ask(b.peer, 1)
    said = await b.event("the autopilot asks for ground that is not here", kind="terrain")
    assert said["detail"]["pieces"] == ["S36E149-37-09"]
    assert "zmav terrain load" in said["text"]
    ask(b.peer, 1)
    await put(b, ground(-35.38, 149.14, -35.33, 149.20))
    assert (await report(b)).missing == []
    assert b.peer.heard("TERRAIN_DATA") == []
    ask(b.peer, 1)
    await b.peer.count("TERRAIN_DATA", 1)
    assert len([e for e in b.events.objects() if e["kind"] == "terrain"]) == 1
    assert (await b.ground.do("terrain_clear")).result == {"cleared": len(ground(-35.38, 149.14, -35.33, 149.20))}
    assert (await report(b)).pieces == []


async def test_an_autopilot_is_asked_to_ask_once_there_is_ground(started: Started) -> None:
    b = await started()
    numbers = {b.peer.dialect.message(name).id for name in NEEDS}

    def asked() -> set[float]:
        return {t.fields["param1"] for t in b.peer.commands(SET_INTERVAL) if t.fields["param2"] > 0} & numbers

    assert asked() == set()
    await put(b, ground(-35.37, 149.15, -35.37, 149.15))
    await b.peer.until(lambda: asked() == numbers, "wish for what is read")


async def test_what_makes_no_sense_is_not_answered(started: Started) -> None:
    b = await started()
    await put(b, ground(-35.38, 149.14, -35.33, 149.20))
    ask(b.peer, 0)
    ask(b.peer, 1, spacing=0)
    ask(b.peer, 1, corner=(2_000_000_000, 0))
    ask(b.peer, 1, corner=(-900_000_000, 0))
    b.peer.packer.compid = 50
    b.peer.raw(b.peer.packer.pack("TERRAIN_REQUEST", lat=CORNER[0], lon=CORNER[1], grid_spacing=100, mask=1))
    b.peer.packer.compid = 1
    ask(b.peer, 1 << 63 | 1 << 7)
    await b.peer.count("TERRAIN_DATA", 1)
    assert [t.fields["gridbit"] for t in b.peer.heard("TERRAIN_DATA")] == [7]


async def test_pieces_that_are_none_are_refused_by_their_names(started: Started) -> None:
    b = await started()
    for pieces in ({"../../etc": "eA=="}, {"S36E149-38-09": "eA=="}, {"S36E149-38-09": "?"}):
        with pytest.raises(BadInput):
            await b.ground.do("terrain_put", pieces=pieces)
    with pytest.raises(BadInput, match="too many for one order"):
        await b.ground.do("terrain_put", pieces={f"S36E149-{i // 60:02}-{i % 60:02}": "" for i in range(129)})
    assert (await report(b)).pieces == []


def test_a_block_at_a_pole_has_places() -> None:
    places = list(Block(899_900_000, 0, 100).places(55))
    assert len(places) == 16
    assert all(math.isfinite(lat) and math.isfinite(lon) for lat, lon in places)
