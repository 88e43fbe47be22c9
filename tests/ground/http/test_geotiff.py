"""GeoTIFFs as they lie on the map: georeferences that are read, and what of others is said."""

from __future__ import annotations

import io
import math
import struct
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from PIL import Image, TiffImagePlugin
from rasterio.warp import transform

from ground.http import geotiff
from ground.http.tiles import Picture
from zmav.errors import BadConfig

if TYPE_CHECKING:
    from tests.ground.http.conftest import Serve

LAT, LON = -35.3633, 149.1652
SCALE, TIE, TRANSFORM, KEYS, NO_DATA = 33550, 33922, 34264, 34735, 42113
DOUBLE, SHORT, ASCII = 12, 3, 2
RED, GREEN, BLUE, GREY = (255, 0, 0), (0, 255, 0), (0, 0, 255), (128, 128, 128)


def write(
    path: Path,
    image: Image.Image,
    *,
    code: int | None = 4326,
    scale: tuple[float, float] | None = (1e-5, 1e-5),
    tie: tuple[float, ...] = (0.0, 0.0, LON, LAT),
    transform: tuple[float, ...] = (),
    point: bool = False,
    empty: str = "",
    **how: Any,
) -> Path:
    """``tie``: column and row, and where that is."""
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    if code is not None:
        kind, key = (2, 2048) if code == 4326 else (1, 3072)
        keys = (1, 1, 0, 3, 1024, 0, 1, kind, 1025, 0, 1, 2 if point else 1, key, 0, 1, code)
        tags.tagtype[KEYS], tags[KEYS] = SHORT, keys
    if transform:
        tags.tagtype[TRANSFORM], tags[TRANSFORM] = DOUBLE, transform
    elif scale is not None:
        column, row, x, y = tie
        tags.tagtype[SCALE], tags[SCALE] = DOUBLE, (*scale, 0.0)
        tags.tagtype[TIE], tags[TIE] = DOUBLE, (column, row, 0.0, x, y, 0.0)
    if empty:
        tags.tagtype[NO_DATA], tags[NO_DATA] = ASCII, empty
    image.save(path, tiffinfo=tags, **how)
    return path


def quarters(width: int = 200, height: int = 100) -> Image.Image:
    """Red and green above blue and grey."""
    image = Image.new("RGB", (width, height), RED)
    image.paste(GREEN, (width // 2, 0, width, height))
    image.paste(BLUE, (0, height // 2, width // 2, height))
    image.paste(GREY, (width // 2, height // 2, width, height))
    return image


def shown(picture: Picture, lat: float, lon: float) -> tuple[int, int, int, int]:
    """The colour at a place, as Leaflet lays it: straight in Web Mercator."""
    assert picture.data is not None
    image = Image.open(io.BytesIO(picture.data)).convert("RGBA")
    south, west, north, east = picture.corners

    def northing(degrees: float) -> float:
        return math.asinh(math.tan(math.radians(degrees)))

    x = (lon - west) / (east - west) * image.width
    y = (northing(north) - northing(lat)) / (northing(north) - northing(south)) * image.height
    found = image.getpixel((int(x), int(y)))
    assert isinstance(found, tuple)
    return found[0], found[1], found[2], found[3]


def like(colour: tuple[int, ...], wanted: tuple[int, int, int]) -> bool:
    return max(abs(a - b) for a, b in zip(colour, wanted, strict=False)) < 60 and colour[3] > 200


@pytest.mark.parametrize("compression", ["raw", "tiff_deflate", "jpeg", "tiff_lzw"])
def test_degrees(tmp_path: Path, compression: str) -> None:
    picture = Picture(write(tmp_path / "field.tif", quarters(), compression=compression))
    assert picture.kind == "image/webp"
    assert picture.corners == pytest.approx((LAT - 1e-3, LON, LAT, LON + 2e-3), abs=1e-9)
    for north, east, colour in ((3, 5, RED), (3, 15, GREEN), (7, 5, BLUE), (7, 15, GREY)):
        assert like(shown(picture, LAT - north * 1e-4, LON + east * 1e-4), colour)


def test_web_mercator(tmp_path: Path) -> None:
    (x,), (y,) = transform("EPSG:4326", "EPSG:3857", [LON], [LAT])
    tie = (0.0, 0.0, x, y)
    picture = Picture(write(tmp_path / "field.tif", quarters(), code=3857, scale=(1.0, 1.0), tie=tie))
    south, west, north, east = picture.corners
    assert (north, west) == pytest.approx((LAT, LON), abs=1e-9)
    ratio = math.cos(math.radians(LAT))
    assert (north - south) * 111_195 == pytest.approx(100 * ratio, rel=0.01)
    assert like(shown(picture, (south + 3 * north) / 4, (3 * east + west) / 4), GREEN)


@pytest.mark.parametrize(("code", "lon", "lat"), [(32755, LON, LAT), (25832, 11.9, 60.0), (2154, 2.0, 43.0)])
def test_a_projection_is_turned_to_true_north(tmp_path: Path, code: int, lon: float, lat: float) -> None:
    (x,), (y,) = transform("EPSG:4326", f"EPSG:{code}", [lon], [lat])
    tie = (0.0, 0.0, x, y)
    picture = Picture(write(tmp_path / "field.tif", quarters(400, 400), code=code, scale=(2.5, 2.5), tie=tie))
    for column, row, colour in ((100, 100, RED), (300, 100, GREEN), (100, 300, BLUE), (300, 300, GREY)):
        for near in (-95, 0, 95):
            there = [x + 2.5 * (column + near)], [y - 2.5 * (row - near)]
            (east,), (north,) = transform(f"EPSG:{code}", "EPSG:4326", *there)
            assert like(shown(picture, north, east), colour), (column, row, near)
    south, west, north, east = picture.corners
    turned = [shown(picture, a, b)[3] for a in (south + 1e-6, north - 1e-6) for b in (west + 1e-6, east - 1e-6)]
    assert max(turned) == 0, "beyond its corners it is clear"


def test_a_point_is_a_pixel_s_middle_and_a_transformation_turns(tmp_path: Path) -> None:
    area = Picture(write(tmp_path / "area.tif", quarters()))
    point = Picture(write(tmp_path / "point.tif", quarters(), point=True))
    assert point.corners[1] == pytest.approx(area.corners[1] - 0.5e-5, abs=1e-10)
    assert point.corners[2] == pytest.approx(area.corners[2] + 0.5e-5, abs=1e-10)
    turned = (0.0, 1e-5, 0.0, LON, 1e-5, 0.0, 0.0, LAT, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
    picture = Picture(write(tmp_path / "turned.tif", quarters(), transform=turned))
    assert picture.corners == pytest.approx((LAT, LON, LAT + 2e-3, LON + 1e-3), abs=1e-9)
    assert like(shown(picture, LAT + 15e-4, LON + 2e-4), GREEN)


def test_a_large_one_is_reduced_and_what_is_empty_is_clear(tmp_path: Path) -> None:
    image = Image.new("L", (9000, 500), 7)
    image.paste(200, (4500, 0, 9000, 500))
    picture = Picture(write(tmp_path / "strip.tif", image, scale=(1e-6, 1e-6), empty="7", compression="tiff_deflate"))
    assert picture.data is not None
    assert Image.open(io.BytesIO(picture.data)).size[0] == geotiff.MOST_SIDE
    assert shown(picture, LAT - 2e-4, LON + 2e-3)[3] == 0
    assert like(shown(picture, LAT - 2e-4, LON + 7e-3), (200, 200, 200))


def test_too_many_pixels_need_overviews(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 200 * 100 // 3)  # Pillow opens none of more than twice as many
    with pytest.raises(BadConfig, match=r"200 x 100 pixels are too many without overviews .*gdaladdo"):
        geotiff.lay(write(tmp_path / "field.tif", quarters()), most=200 * 100 - 1)
    small, marked = quarters(100, 50), TiffImagePlugin.ImageFileDirectory_v2()
    marked[254] = 1  # a reduced image of the one before
    small.encoderinfo = {"tiffinfo": marked}
    path = write(tmp_path / "overviews.tif", quarters(), save_all=True, append_images=[small])
    with pytest.raises(BadConfig, match="too many without overviews"):
        geotiff.lay(path, side=150, most=200 * 100 - 1)
    laid = geotiff.lay(path, side=50, most=200 * 100 - 1)
    assert laid.corners == pytest.approx((LAT - 1e-3, LON, LAT, LON + 2e-3), abs=1e-9)
    assert Image.open(io.BytesIO(laid.data)).size == (50, 31)  # a degree of longitude is shorter there


@pytest.mark.parametrize(
    ("more", "why"),
    [
        ({"code": 32767}, "does not say in which coordinates"),
        ({"code": None}, "does not say in which coordinates"),
        ({"scale": None}, "no georeference"),
        ({"scale": (0.0, 1e-5)}, "does not say in which coordinates"),  # GDAL leaves out both then
        ({"scale": (math.nan, 1e-5)}, "no extent"),
        ({"tie": (0.0, 0.0, LON, 89.0)}, "does not lie on the map"),
        ({"tie": (0.0, 0.0, 179.999, LAT)}, "lies across the 180th meridian"),
        ({"tie": (0.0, 0.0, 1e300, LAT)}, "does not lie on the map|no extent"),
        ({"code": 32755, "scale": (1e5, 1e5), "tie": (0.0, 0.0, 5e5, 6e6)}, "does not lie on the map"),
    ],
)
def test_what_cannot_be_laid_says_why_and_what_helps(tmp_path: Path, more: dict[str, Any], why: str) -> None:
    with pytest.raises(BadConfig, match=f"({why}).*gdalwarp"):
        Picture(write(tmp_path / "field.tif", quarters(), **more))


def test_a_projection_that_is_not_named_is_not_taken_for_degrees(tmp_path: Path) -> None:
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    tags.tagtype[KEYS], tags[KEYS] = SHORT, (1, 1, 0, 2, 1024, 0, 1, 1, 2048, 0, 1, 4326)
    tags.tagtype[SCALE], tags[SCALE] = DOUBLE, (0.1, 0.1, 0.0)
    tags.tagtype[TIE], tags[TIE] = DOUBLE, (0.0, 0.0, 0.0, 10.0, 20.0, 0.0)
    quarters().save(tmp_path / "local.tif", tiffinfo=tags)
    with pytest.raises(BadConfig, match="does not say in which coordinates"):
        Picture(tmp_path / "local.tif")


def test_a_picture_of_named_colours_and_one_of_grey_and_opacity(tmp_path: Path) -> None:
    named = Picture(write(tmp_path / "named.tif", quarters().quantize(8)))
    veiled = Image.new("LA", (200, 100), (128, 255))
    veiled.paste((128, 0), (0, 0, 100, 100))
    grey = Picture(write(tmp_path / "grey.tif", veiled))
    for north, east, colour in ((3, 5, RED), (3, 15, GREEN), (7, 5, BLUE), (7, 15, GREY)):
        assert like(shown(named, LAT - north * 1e-4, LON + east * 1e-4), colour)
    assert shown(grey, LAT - 5e-4, LON + 5e-4)[3] == 0
    assert like(shown(grey, LAT - 5e-4, LON + 15e-4), GREY)


def test_heights_are_no_picture(tmp_path: Path) -> None:
    with pytest.raises(BadConfig, match=r"its pixels are numbers.*gdalwarp -t_srs EPSG:4326 -ot Byte"):
        Picture(write(tmp_path / "dem.tif", Image.fromarray(np.ones((50, 50), dtype=np.float32))))


def test_broken_files_are_refused_and_nothing_else_is_raised(tmp_path: Path) -> None:
    whole = write(tmp_path / "field.tif", quarters(64, 64), compression="tiff_deflate").read_bytes()
    random, path, refused = np.random.default_rng(5), tmp_path / "broken.tif", 0
    for trial in range(150):
        data = bytearray(whole)
        for place in random.integers(4, len(data), 1 + trial % 40):
            data[place] = random.integers(256)
        path.write_bytes(bytes(data[: random.integers(8, len(data) + 1)]) if trial % 3 == 0 else bytes(data))
        try:
            Picture(path)
        except BadConfig:
            refused += 1
    assert refused > 30
    for text in (b"II*\0", b"II*\0" + struct.pack("<I", 8), b"MM\0+" + b"\xff" * 40):
        path.write_bytes(text)
        with pytest.raises(BadConfig, match=r"broken\.tif"):
            Picture(path)


def test_the_page_is_given_it(tmp_path: Path, serve: Serve) -> None:
    picture = Picture(write(tmp_path / "field.tif", quarters()))
    served = serve(picture=picture)
    reply = served.get("/picture")
    assert (reply.headers["content-type"], reply.body) == ("image/webp", picture.data)
    assert 'name="zmav-picture" content="-35.364' in served.get("/").text
    with pytest.raises(BadConfig, match="says itself where it lies"):
        Picture(tmp_path / "field.tif", (0.0, 0.0, 1.0, 1.0))
