"""Pieces of ground: their names, their heights, and what is no piece."""

from __future__ import annotations

import array
import itertools
import zlib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zmav.errors import BadInput
from zmav.terrain import KEPT, VOID, Piece, Terrain, corner_of, name_of, names_within, pack, piece_at, unpack


def slope(side: int = 21, *, east: int = 100, north: int = 200, base: int = 500) -> Piece:
    """So many metres higher at the east edge, and at the north edge."""
    last = side - 1
    rows = ((base + north * (last - row) // last + east * col // last) for row in range(side) for col in range(side))
    return Piece(side, array.array("h", rows))


@given(st.floats(-89.99, 89.99), st.floats(-180.0, 179.999))
def test_a_place_lies_in_its_piece(lat: float, lon: float) -> None:
    name, north, east = piece_at(lat, lon)
    south, west = corner_of(name)
    assert name_of(south, west) == name
    assert 0.0 <= north <= 1.0
    assert 0.0 <= east <= 1.0
    assert (south + north) / 60.0 == pytest.approx(lat, abs=1e-9)
    assert (west + east) / 60.0 == pytest.approx(lon, abs=1e-9)


def test_names_are_those_of_srtm() -> None:
    assert piece_at(-35.363262, 149.165237)[0] == "S36E149-38-09"
    assert piece_at(47.5, -0.001)[0] == "N47W001-30-59"
    assert list(names_within(47.49, 179.99, 47.51, -179.99)) == [
        "N47E179-29-59",
        "N47W180-29-00",
        "N47E179-30-59",
        "N47W180-30-00",
    ]


@pytest.mark.parametrize(("west", "east"), [(-180.0, 180.0), (0.0, 360.0), (-180.0, 179.9999)])
def test_an_area_around_the_earth_touches_each_piece_once(west: float, east: float) -> None:
    found = list(names_within(0.0, west, 0.001, east))
    assert len(found) == len(set(found)) == 360 * 60


@pytest.mark.parametrize(
    "name", ["", "S36E149", "S36E149-60-09", "S36E149-38-9", "s36e149-38-09", "N91E000-00-00", "N00E180-00-00", "../a"]
)
def test_what_is_no_name_is_refused(name: str) -> None:
    with pytest.raises(BadInput) as caught:
        corner_of(name)
    assert caught.value.detail["value"] == name


def test_heights_lie_between_their_neighbours() -> None:
    piece = slope()
    assert piece.height(0.0, 0.0) == 500
    assert piece.height(1.0, 1.0) == 800
    assert piece.height(0.5, 0.25) == pytest.approx(625.0)
    assert piece.height(0.525, 0.25) == pytest.approx(630.0)
    piece.heights[0] = VOID  # the north-west corner
    assert piece.height(0.99, 0.01) is None
    assert piece.height(0.9, 0.1) is not None


def test_a_piece_crosses_the_network_as_it_was() -> None:
    for side in (2, 21, 61, 241):
        piece = slope(side, base=-500)
        assert unpack("S36E149-38-09", pack(piece)) == piece


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"nonsense",
        zlib.compress(b""),
        zlib.compress(bytes(7)),
        zlib.compress(bytes(2)),
        zlib.compress(bytes(2 * 20 * 21)),
        pack(slope())[:-3],
        zlib.compress(bytes(1 << 24)),  # much from little
        pack(slope(base=9001)),
        pack(slope(base=-700)),
        pack(Piece(2, array.array("h", [VOID, -600, 0, 0]))),  # what is not known hides nothing
        pack(Piece(2, array.array("h", [VOID, 9001, 0, 0]))),
    ],
    ids=itertools.count(),
)
def test_what_is_no_piece_is_refused(data: bytes, tmp_path: Path) -> None:
    terrain = Terrain(tmp_path / "ground")
    with pytest.raises(BadInput, match="S36E149-38-09"):
        terrain.put("S36E149-38-09", data)
    assert terrain.names() == []
    (tmp_path / "ground").mkdir(exist_ok=True)
    (tmp_path / "ground" / "S36E149-38-09").write_bytes(data)
    assert terrain.height(-35.363262, 149.165237) is None
    assert "S36E149-38-09" in terrain.faults["S36E149-38-09"]


def test_what_is_kept_is_there_after_a_restart(tmp_path: Path) -> None:
    terrain = Terrain(tmp_path / "ground")
    assert terrain.height(-35.363262, 149.165237) is None
    for east in range(KEPT + 5):
        terrain.put(name_of(0, east), pack(slope(base=east)))
    again = Terrain(tmp_path / "ground")
    assert len(again.names()) == KEPT + 5
    for found in (terrain, again):
        assert [found.height(0.0, east / 60.0 + 1e-9) for east in range(KEPT + 5)] == pytest.approx(
            list(range(KEPT + 5)), abs=1e-4
        )
    terrain.put(name_of(0, 3), pack(slope(base=77)))
    assert terrain.height(0.0, 3 / 60.0 + 1e-9) == pytest.approx(77, abs=1e-4)
    assert terrain.clear() == KEPT + 5
    assert terrain.height(0.0, 3 / 60.0) is None


def test_a_void_is_no_height_that_is_refused() -> None:
    for heights in ([VOID] * 4, [VOID, -500, 9000, 0]):
        piece = Piece(2, array.array("h", heights))
        assert unpack("S36E149-38-09", pack(piece)) == piece


def test_memory_and_disk_are_bounded(tmp_path: Path) -> None:
    terrain = Terrain(tmp_path / "ground")
    terrain.kept, terrain.most = 2, 5
    for east in range(5):
        terrain.put(name_of(0, east), pack(slope()))
    (tmp_path / "ground" / name_of(0, 0)).rename(tmp_path / "aside")
    assert terrain.height(0.0, 1e-9) is None, "no longer in memory"
    (tmp_path / "aside").rename(tmp_path / "ground" / name_of(0, 0))
    with pytest.raises(BadInput, match="zmav terrain clear"):
        terrain.put(name_of(0, 5), pack(slope()))
    terrain.put(name_of(0, 4), pack(slope(base=7)))  # in place of what was there
    assert len(terrain.names()) == 5
    (tmp_path / "ground" / name_of(0, 1)).write_bytes(b"nonsense")
    assert terrain.height(0.0, 1 / 60.0 + 1e-9) is None
    assert terrain.faults
    terrain.clear()
    assert terrain.faults == {}


def test_no_place_on_earth_has_no_ground(tmp_path: Path) -> None:
    terrain = Terrain(tmp_path)
    for lat, lon in ((90.0, 0.0), (float("nan"), 0.0), (0.0, float("inf")), (-1e9, 0.0)):
        assert terrain.height(lat, lon) is None
