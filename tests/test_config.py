"""The fleet file: what is taken, and how what is wrong is named."""

from __future__ import annotations

from pathlib import Path

import pytest

from zmav import config
from zmav.config import Failsafe, Limits, PilotSwitch, load_fleet, origin_of
from zmav.errors import BadConfig, BadKey

GOOD = """
fleet = "alpha"

[origin]
lat_deg = 52.756
lon_deg = -1.246
alt_amsl = 60.0

[failsafe]
hold_after = 0.4
land_after = 20
action = "land"
return = "together"

[geofence]
polygon = [[52.75, -1.25], [52.76, -1.25], [52.76, -1.24]]
radius = 300.0
floor = 2.0
ceiling = 60.0

[limits]
speed = 12.0

[vehicles.quad1]
link = "/dev/ttyAMA0,921600"
sysid = 7
listen = ["tcp/127.0.0.1:7447", "udp/10.77.0.1:7447?rel=1;mixed_rel=1"]

[vehicles.quad1.pilot_switch]
channel = 7
high = 2100

[vehicles.quad1.failsafe]
land_after = "never"

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
        "/dev/ttyAMA0,921600",
        7,
        "ardupilotmega",
        2,
        [],
    )
    assert (two.sysid, two.dialect, two.listen) == (None, "common", [])
    assert two.connect == ["udp/10.77.0.1:7447?rel=1;mixed_rel=1"]


def test_a_vehicle_s_own_table_takes_the_place_of_the_fleet_s(path: Path) -> None:
    path.write_text(GOOD)
    fleet = load_fleet(path)
    one, two = fleet.vehicle("quad1"), fleet.vehicle("quad2")
    assert one.failsafe == Failsafe(hold_after=0.5, land_after="never", action="rtl")
    assert two.failsafe == Failsafe(hold_after=0.4, land_after=20.0, action="land", returns="together")
    assert one.geofence == two.geofence == fleet.geofence
    assert fleet.geofence.polygon == [(52.75, -1.25), (52.76, -1.25), (52.76, -1.24)]
    assert one.limits == Limits(speed=12.0)
    assert (one.pilot_switch, two.pilot_switch) == (PilotSwitch(channel=7, low=1700, high=2100), None)


def test_the_example_in_the_documentation_is_read(path: Path) -> None:
    path.write_text((config.fleet.__doc__ or "").partition("\n\n")[2].rpartition("\n\n")[0])
    assert load_fleet(path).vehicle("quad1").pilot_switch == PilotSwitch(channel=7, low=1700, high=2200)


def test_an_empty_file_is_the_demo_fleet(path: Path) -> None:
    path.write_text("")
    fleet = load_fleet(path)
    assert (fleet.fleet, fleet.origin, fleet.vehicles) == ("demo", None, {})


def test_a_radius_needs_an_origin(path: Path) -> None:
    path.write_text("[geofence]\nradius = 100.0\n")
    with pytest.raises(BadConfig, match="about the fleet's origin, and none is declared"):
        load_fleet(path)


def test_a_missing_vehicle_is_told_with_those_there_are(path: Path) -> None:
    path.write_text(GOOD)
    with pytest.raises(BadConfig, match=r"no vehicle 'quad9'.*quad1, quad2"):
        load_fleet(path).vehicle("quad9")


@pytest.mark.parametrize(
    ("before", "after", "field", "words"),
    [
        ('fleet = "alpha"', 'flete = "alpha"', "the file", "unknown field `flete`"),
        ("sysid = 7", "system = 7", "vehicles.quad1", "unknown field `system`"),
        ("sysid = 7", 'sysid = "7"', "vehicles.quad1.sysid", "Expected `int | null`"),
        ("sysid = 7", "sysid = 0", "vehicles.quad1.sysid", ">= 1"),
        ("sysid = 7", "sysid = 256", "vehicles.quad1.sysid", "<= 255"),
        ('link = "udpin:127.0.0.1:14550"', "", "vehicles.quad2", "missing required field `link`"),
        ("lat_deg = 52.756", "", "origin", "missing required field `lat_deg`"),
        ("lat_deg = 52.756", "lat_deg = 91.0", "origin.lat_deg", "±89"),
        ("lon_deg = -1.246", "lon_deg = nan", "origin.lon_deg", "not a number (nan)"),
        ("alt_amsl = 60.0", "alt_amsl = inf", "origin.alt_amsl", "infinite (inf)"),
        ('fleet = "alpha"', 'fleet = "Alpha Team"', "name", "lower-case"),
        ("[vehicles.quad2]", '[vehicles."quad 2"]', "name", "lower-case"),
        ('fleet = "alpha"', 'fleet = "alpha', "file", "not TOML"),
        ('fleet = "alpha"', "fleet == 1", "file", "not TOML"),
        ("hold_after = 0.4", "hold_after = 0.05", "failsafe.hold_after", ">= 0.1"),
        ("hold_after = 0.4", "hold_after = nan", "failsafe.hold_after", "not a number (nan)"),
        ("land_after = 20", 'land_after = "later"', "failsafe.land_after", "Invalid enum value 'later'"),
        ("land_after = 20", "land_after = 0.2", "failsafe.land_after", ">= 1.0"),
        (
            "hold_after = 0.4\nland_after = 20",
            "hold_after = 3.0\nland_after = 2.0",
            "failsafe.land_after",
            "hold_after",
        ),
        ('action = "land"', 'action = "fall"', "failsafe.action", "Invalid enum value 'fall'"),
        ('return = "together"', 'return = "alone"', "failsafe.return", "Invalid enum value 'alone'"),
        ("land_after = 20", 'land_after = "never"', "failsafe.return", "land_after"),
        ('action = "land"', "actoin = 1", "failsafe", "unknown field `actoin`"),
        ("[52.75, -1.25], [52.76, -1.25], [52.76, -1.24]", "[52.75, -1.25]", "geofence.polygon", "three corners"),
        ("[52.75, -1.25],", "[152.75, -1.25],", "geofence.polygon", "latitude and longitude"),
        ("radius = 300.0", "radius = -1.0", "geofence.radius", "> 0.0"),
        ("radius = 300.0", "radius = nan", "geofence.radius", "not a number (nan)"),
        ("floor = 2.0", "floor = 60.0", "geofence.floor", "less than the ceiling"),
        ("floor = 2.0", "above_ground = -5.0", "geofence.above_ground", "metres above the ground"),
        ("speed = 12.0", "speed = 0", "limits.speed", "> 0.0"),
        ("speed = 12.0", "accel = inf", "limits.accel", "infinite (inf)"),
        ("channel = 7", "channel = 19", "vehicles.quad1.pilot_switch.channel", "<= 18"),
        ('land_after = "never"', "land_after = 0.5", "vehicles.quad1.failsafe.land_after", ">= 1.0"),
        ('land_after = "never"', "hold_after = nan", "vehicles.quad1.failsafe.hold_after", "not a number (nan)"),
        ("[52.75, -1.25],", "[nan, -1.25],", "geofence.polygon[0][0]", "not a number (nan)"),
        ("speed = 12.0", "[mesh.thin]\nATTITUDE = 4\nVFR_HUD = -1", "mesh.thin.VFR_HUD", "> 0.0"),
        ('dialect = "common"', "sysid = 7", "vehicles.quad2.sysid", "quad1 has this one"),
        ("high = 2100", "high = 1700", "vehicles.quad1.pilot_switch.low", "less than 1700"),
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
    ("one", "other", "refused"),
    [
        ('link = "tcp:127.0.0.1:5760"', 'link = "tcp:127.0.0.1:5760"', True),
        ('link = "tcp:10.0.0.5:5760"', 'link = "tcp:10.0.0.5:5760"\nlisten = ["tcp/10.0.0.2:7447"]', True),
        ('link = "/dev/ttyACM0"\nsim = {}', 'link = "/dev/ttyACM0"\nsim = {}', False),  # each on its own computer
        ('link = "serial:/dev/ttyAMA0:921600"', 'link = "serial:/dev/ttyAMA0:921600"', False),
        (
            'link = "udpin:0.0.0.0:14550"\nlisten = ["tcp/10.0.0.1:7447"]',
            'link = "udpin:0.0.0.0:14550"\nconnect = ["tcp/10.0.0.1:7447"]',
            False,
        ),
    ],
)
def test_one_link_of_two_vehicles_is_refused(path: Path, one: str, other: str, refused: bool) -> None:
    path.write_text(f"[vehicles.quad1]\n{one}\n[vehicles.quad2]\n{other}\n")
    if not refused:
        assert list(load_fleet(path).vehicles) == ["quad1", "quad2"]
        return
    with pytest.raises(BadConfig, match="quad1 has this one") as caught:
        load_fleet(path)
    assert caught.value.detail["field"] == "vehicles.quad2.link"


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


def test_cameras_have_streams_the_richest_first(tmp_path: Path) -> None:
    path = tmp_path / "fleet.toml"
    text = '[vehicles.quad1]\nlink = "udpin:0.0.0.0:14550"\n[vehicles.quad1.cameras.{name}]\nstreams = {streams}\n'
    path.write_text(text.format(name="down", streams='["/dev/video0", "rtsp://a:b@camera/main", "rtsp://camera/sub"]'))
    camera = load_fleet(path).vehicle("quad1").cameras["down"]
    assert len(camera.streams) == 3
    assert camera.uri == "rtsp://camera/sub", "what a station may open by itself: no device, and no password"
    assert config.CameraConfig(streams=["clock"]).uri is None
    for name, streams, words in (
        ("down", "[]", "streams"),
        ("Down", '["clock"]', "cameras 'Down' cannot stand in a key"),
    ):
        path.write_text(text.format(name=name, streams=streams))
        with pytest.raises((BadConfig, BadKey), match=words):
            load_fleet(path)
