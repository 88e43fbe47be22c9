"""The fleet file: what is taken, and how what is wrong is named."""

from __future__ import annotations

from pathlib import Path

import pytest

from zmav.config import load_fleet, origin_of
from zmav.errors import BadConfig

GOOD = """
fleet = "alpha"

[origin]
lat_deg = 52.756
lon_deg = -1.246
alt_amsl = 60.0

[vehicles.quad1]
link = "/dev/ttyAMA0,921600"
sysid = 7
listen = ["tcp/127.0.0.1:7447", "udp/10.77.0.1:7447?rel=1;mixed_rel=1"]

[vehicles.quad2]
link = "udpin:127.0.0.1:14550"
dialect = "common"
connect = ["udp/10.77.0.1:7447?rel=1;mixed_rel=1"]
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "fleet.toml"


def test_a_whole_file(path: Path) -> None:
    path.write_text(GOOD)
    fleet = load_fleet(path)
    assert fleet.fleet == "alpha"
    assert fleet.origin and (fleet.origin.lat_deg, fleet.origin.lon_deg, fleet.origin.alt_amsl) == (52.756, -1.246, 60)
    one, two = fleet.vehicle("quad1"), fleet.vehicle("quad2")
    assert (one.link, one.sysid, one.dialect, len(one.listen), one.connect) == (
        "/dev/ttyAMA0,921600", 7, "ardupilotmega", 2, [],
    )  # fmt: skip
    assert (two.sysid, two.dialect, two.listen) == (None, "common", [])
    assert two.connect == ["udp/10.77.0.1:7447?rel=1;mixed_rel=1"]


def test_an_empty_file_is_the_demo_fleet(path: Path) -> None:
    path.write_text("")
    fleet = load_fleet(path)
    assert (fleet.fleet, fleet.origin, fleet.vehicles) == ("demo", None, {})


def test_a_missing_vehicle_is_told_with_those_there_are(path: Path) -> None:
    path.write_text(GOOD)
    with pytest.raises(BadConfig, match=r"no vehicle 'quad9'.*quad1, quad2"):
        load_fleet(path).vehicle("quad9")


@pytest.mark.parametrize(
    ("before", "after", "field", "words"),
    [
        ('fleet = "alpha"', 'flete = "alpha"', "the file", "unknown field `flete`"),
        ("sysid = 7", "system = 7", "vehicles[...]", "unknown field `system`"),
        ("sysid = 7", 'sysid = "7"', "vehicles[...].sysid", "Expected `int | null`"),
        ("sysid = 7", "sysid = 0", "vehicles[...].sysid", ">= 1"),
        ("sysid = 7", "sysid = 256", "vehicles[...].sysid", "<= 255"),
        ('link = "udpin:127.0.0.1:14550"', "", "vehicles[...]", "missing required field `link`"),
        ("lat_deg = 52.756", "", "origin", "missing required field `lat_deg`"),
        ("lat_deg = 52.756", "lat_deg = 91.0", "origin.lat_deg", "±89"),
        ("lon_deg = -1.246", "lon_deg = nan", "origin.lon_deg", "±180"),
        ("alt_amsl = 60.0", "alt_amsl = inf", "origin.alt_amsl", "±10000"),
        ('fleet = "alpha"', 'fleet = "Alpha Team"', "name", "lower-case"),
        ("[vehicles.quad2]", '[vehicles."quad 2"]', "name", "lower-case"),
        ('fleet = "alpha"', 'fleet = "alpha', "file", "not TOML"),
        ('fleet = "alpha"', "fleet == 1", "file", "not TOML"),
    ],
)
def test_what_is_wrong_is_named(path: Path, before: str, after: str, field: str, words: str) -> None:
    assert GOOD.count(before) == 1
    path.write_text(GOOD.replace(before, after))
    with pytest.raises(BadConfig) as caught:
        load_fleet(path)
    assert str(path) in caught.value.message
    assert words in caught.value.message
    assert caught.value.detail["field"] == field


@pytest.mark.parametrize(
    ("name", "words"), [("absent.toml", "No such file"), (".", "directory"), ("latin.toml", "not TOML")]
)
def test_a_file_that_cannot_be_read(tmp_path: Path, name: str, words: str) -> None:
    (tmp_path / "latin.toml").write_bytes(b'fleet = "\xe9"')
    with pytest.raises(BadConfig, match=words):
        load_fleet(tmp_path / name)


def test_an_origin_must_be_a_place() -> None:
    assert origin_of(-35.363261, 149.16523, 584.09).alt_amsl == 584.09
    with pytest.raises(BadConfig, match=r"lat_deg is 90\.0"):
        origin_of(90.0, 0.0, 0.0)
    with pytest.raises(BadConfig, match="lon_deg is -181"):
        origin_of(0.0, -181.0, 0.0)
    with pytest.raises(BadConfig, match="alt_amsl is nan"):
        origin_of(0.0, 0.0, float("nan"))
