"""The fleet file as the simulator reads it: what it says, what the links mean, and what is refused."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from zmav.config import load_fleet
from zmav.errors import BadConfig
from zmav.sim import Home, World
from zmav.sim.endpoints import addresses
from zmav.sim.faults import KINDS
from zmav.sim.fleetfile import FleetFile, load_simulated, speed_of
from zmav.sim.lineup import gather, line_up

if TYPE_CHECKING:
    from collections.abc import Callable

    Read = Callable[[str], FleetFile]

WHOLE = """
fleet = "alpha"

[origin]
lat_deg = 47.3977
lon_deg = 8.5456
alt_amsl = 488.0

[sim]
wind = "5@270,gusty"
speed = 0
noise = "typical"
seed = 3
scene = "field.toml"


[vehicles.quad1]
link = "tcp:127.0.0.1:5760"
sysid = 7

[vehicles.quad1.sim]
airframe = "hexa"
start_ned_m = [0.0, 10.0, 0.0]
yaw_deg = 90
params = { FS_GCS_ENABLE = 1 }

[vehicles.quad1.sim.camera]
rate_hz = 15

[vehicles.ugv]
link = "udpin:127.0.0.1:14550"
sim = { autopilot = "ardurover" }

[vehicles.real]
link = "/dev/ttyACM0"
"""


@pytest.fixture
def read(tmp_path: Path) -> Read:
    def read(text: str) -> FleetFile:
        (tmp_path / "field.toml").write_text('ground = "asphalt"\n')
        (tmp_path / "fleet.toml").write_text(text)
        return load_simulated(tmp_path / "fleet.toml")

    return read


def test_everything_it_says(read: Read, tmp_path: Path) -> None:
    file = read(WHOLE)
    assert file.home == Home(47.3977, 8.5456, 488.0, 0.0)
    assert (file.world.wind, file.world.noise, file.world.seed) == ("5@270,gusty", "typical", 3)
    assert speed_of(file.world) == math.inf
    assert file.scene is not None
    assert file.scene.ground == "asphalt"
    quad, rover = file.vehicles
    assert (quad.name, quad.sysid, quad.airframe, quad.yaw_deg) == ("quad1", 7, "hexa", 90.0)
    assert (quad.start_ned_m, quad.params, quad.endpoints) == (
        (0.0, 10.0, 0.0),
        {"FS_GCS_ENABLE": 1.0},
        ("tcp:127.0.0.1:5760",),
    )
    assert quad.camera is not None
    assert quad.camera.rate_hz == 15.0
    assert (rover.name, rover.sysid, rover.autopilot) == ("ugv", None, "ardurover")
    # The agents read the same file.
    assert load_fleet(tmp_path / "fleet.toml").vehicle("quad1").link == "tcp:127.0.0.1:5760"


def test_names_and_ids_of_the_world_are_the_files(read: Read) -> None:
    specs = line_up(gather(read(WHOLE).vehicles, {"copter": 1}), Home(), 10.0)
    assert [(spec.name, spec.sysid) for spec in specs] == [("quad1", 7), ("ugv", 2), ("quad2", 3)]


@pytest.mark.parametrize(
    ("autopilot", "link", "endpoint"),
    [
        ("arducopter", "tcp:127.0.0.1:5760", "tcp:127.0.0.1:5760"),
        ("arducopter", "tcp::5760", "tcp:127.0.0.1:5760"),
        ("arducopter", "udpin:0.0.0.0:14550", "udp:127.0.0.1:14550"),
        ("arducopter", "udpin:10.77.0.1:14550", "udp:10.77.0.1:14550"),
        ("arducopter", "udpout:127.0.0.1:14600", "udp-listen:127.0.0.1:14600"),
        ("arducopter", "/tmp/quad1,57600", "pty:/tmp/quad1"),
        ("arducopter", "serial:/tmp/quad1", "pty:/tmp/quad1"),
        ("px4", "udpin:127.0.0.1:14541", "onboard:14581:127.0.0.1:14541"),
        ("px4", "udpin:127.0.0.1:15000", "onboard:0:127.0.0.1:15000"),
    ],
)
def test_a_vehicle_is_where_its_link_leads(read: Read, autopilot: str, link: str, endpoint: str) -> None:
    (spec,) = read(f'[vehicles.q]\nlink = "{link}"\nsim = {{ autopilot = "{autopilot}" }}\n').vehicles
    assert spec.endpoints == (endpoint,)


def test_endpoints_of_its_own_come_first(read: Read) -> None:
    (spec,) = read('[vehicles.q]\nlink = "/dev/ttyACM0"\nsim = { endpoints = ["tcp:0", "pty"] }\n').vehicles
    assert spec.endpoints == ("tcp:0", "pty")


QUAD = '[vehicles.q]\nlink = "tcp:127.0.0.1:5760"\n'


@pytest.mark.parametrize(
    ("text", "field", "words"),
    [
        ("[vehicles\n", "file", "is not TOML: .*line 1"),
        ("", "vehicles", "nothing is to be simulated"),
        (QUAD, "vehicles", r"a table \[vehicles.NAME.sim\]"),
        (QUAD + "sim = { airfraem = 'hexa' }", "vehicles.q.sim", "unknown field `airfraem`"),
        (QUAD + "sim = { airframe = 'zeppelin' }", "airframe", "'zeppelin'; expected quad or hexa"),
        (QUAD + "sim = { autopilot = 'ardusub' }", "autopilot", "expected arducopter or"),
        (QUAD + "sim = { sysid = 4 }", "vehicles.q.sim.sysid", r"the one that \[vehicles.q\] has"),
        (QUAD + "sim = { params = { X = 'on' } }", "vehicles.q.sim.params[...]", "Expected `float`"),
        (QUAD + "sim = { camera = { rate = 5 } }", "vehicles.q.sim.camera", "unknown field `rate`"),
        (QUAD + "sim = {}\n[sim]\nwind = 'strong'", "wind", "'strong'; expected SPEED"),
        (QUAD + "sim = {}\n[sim]\nweather = 1", "sim", "unknown field `weather`"),
        (QUAD + "sim = {}\n[sim]\nhome = { lat_deg = 91 }", "lat_deg", "91.0; expected ±89"),
        (QUAD + "sim = {}\n[sim]\nscene = 'none.toml'", "scene", "none.toml"),
        ('[vehicles.q]\nlink = "/dev/ttyACM0"\nsim = {}', "vehicles.q.link", "cannot be simulated"),
        (
            QUAD + "sysid = 3\nsim = {}\n[vehicles.p]\nlink = 'tcp:127.0.0.1:5770'\nsysid = 3\nsim = {}",
            "vehicles.p.sysid",
            "a system id of its own: q has this one",
        ),
    ],
)
def test_what_is_wrong_is_named(read: Read, tmp_path: Path, text: str, field: str, words: str) -> None:
    with pytest.raises(BadConfig, match=words) as caught:
        read(text)
    assert caught.value.detail["field"] == field
    assert str(tmp_path) in str(caught.value)


def test_a_world_is_made_of_it(read: Read) -> None:
    file = read(WHOLE)
    world = World(file.vehicles[:1], home=file.home, noise=file.world.noise)
    assert [v.name for v in world.vehicles] == ["quad1"]
    assert world.vehicles[0].copter.params["FS_GCS_ENABLE"] == 1.0
    world.close()


class TestGuide:
    """docs/simulator.md says what is true."""

    guide = (Path(__file__).parent.parent.parent / "docs" / "simulator.md").read_text(encoding="utf-8")

    def test_its_fleet_file_is_one(self, read: Read) -> None:
        file = read(self.guide.partition("```toml\n")[2].partition("```")[0])
        assert [spec.name for spec in file.vehicles] == ["quad1", "ugv1", "wing1", "scout1"]
        world = World(file.vehicles, home=file.home, scene=file.scene)
        assert [v.status().kind for v in world.vehicles] == ["hexa", "rover", "plane", "px4"]
        world.close()

    def test_it_lists_every_fault(self) -> None:
        for kind, fault in KINDS.items():
            (row,) = [line for line in self.guide.splitlines() if line.startswith(f"| `{kind}` |")]
            assert " ".join((fault.__doc__ or "").split()) in row

    def test_its_endpoints_can_be_written_so(self) -> None:
        for text in ("ardupilot", "px4", "pty:/tmp/quad1+", "tcp", "serial1", "serial2"):
            assert f"`{text}`" in self.guide or f" {text} " in self.guide
            assert addresses([[text]])
