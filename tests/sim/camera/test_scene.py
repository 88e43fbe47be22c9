"""Scene files, cameras and pads in specifications: what is taken, and what is said of the rest."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from zmav.errors import BadConfig, BadInput
from zmav.hil.externals import Externals
from zmav.sim import VehicleSpec, World
from zmav.sim.camera import CameraSpec, PadSpec, PlacedPad, Road, Roof, Scene, load_scene
from zmav.sim.camera import scene as scene_module
from zmav.sim.spec import Stack

FULL = """
ground = "asphalt"

[[roads]]
points = [[0.0, -50.0], [0.0, 50.0], [30.0, 80.0]]
width_m = 4.0

[[pads]]
position = [20.0, 1]
heading_deg = 30.0
pad = { symbol_m = 1.0, shape = "square", size_m = 2.0, color = "yellow", background = "#102030" }

[[roofs]]
center = [0.0, 20.0]
size = [6.0, 12.0]
height_m = 5.0
"""


def write(folder: Path, text: str) -> Path:
    path = folder / "scene.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_scene_file(tmp_path: Path) -> None:
    pad = PadSpec(symbol_m=1.0, shape="square", size_m=2.0, color="yellow", background="#102030")
    assert load_scene(write(tmp_path, FULL)) == Scene(
        ground="asphalt",
        roads=(Road(points=((0.0, -50.0), (0.0, 50.0), (30.0, 80.0)), width_m=4.0),),
        pads=(PlacedPad(position=(20.0, 1.0), heading_deg=30.0, pad=pad),),
        roofs=(Roof(center=(0.0, 20.0), size=(6.0, 12.0), height_m=5.0),),
    )


def test_the_example_in_the_documentation_is_one(tmp_path: Path) -> None:
    _, _, example = (scene_module.__doc__ or "").partition("\n\n")
    scene = load_scene(write(tmp_path, example))
    assert (len(scene.roads), len(scene.pads), len(scene.roofs)) == (1, 1, 1)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ('ground = "lawn"', "ground"),
        ("grund = 1", "grund"),
        ("[[roads]]\npoints = [[0.0, 0.0]]", "roads"),
        ("[[roofs]]\ncenter = [0.0, 0.0]\nsize = [0.0, 1.0]", "size"),
        ("[[roofs]]\ncenter = [0.0, nan]\nsize = [1.0, 1.0]", "center"),
        ('[[pads]]\nposition = [0, 0]\npad = { color = "mauve" }', "mauve"),
        ("[[pads]]\nposition = [0, 0]\npad = { stroke_ratio = 0.4 }", "stroke_ratio"),
        ("ground = \nroads = []", "line 1"),
    ],
)
def test_what_cannot_be_is_named_with_its_file(tmp_path: Path, text: str, named: str) -> None:
    with pytest.raises(BadConfig, match=named) as caught:
        load_scene(write(tmp_path, text))
    assert "scene.toml" in str(caught.value)


def test_no_such_file(tmp_path: Path) -> None:
    with pytest.raises(BadConfig, match=r"nowhere\.toml"):
        load_scene(tmp_path / "nowhere.toml")


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"width": 3}, "width"),
        ({"focal_px": float("nan")}, "focal_px"),
        ({"rate_hz": 0.0}, "rate_hz"),
        ({"offset_m": (0.0, float("inf"), 0.0)}, "offset_m"),
    ],
)
def test_a_camera_that_cannot_be(options: dict[str, Any], named: str) -> None:
    with pytest.raises(BadConfig, match=rf"vehicle 1: camera.*{named}"):
        World([VehicleSpec(camera=CameraSpec(**options))])


def test_a_pad_that_cannot_be() -> None:
    with pytest.raises(BadConfig, match=r"vehicle 1: pad\.background"):
        World([VehicleSpec(pad=PadSpec(background="no colour"))])


def test_a_scene_that_cannot_be() -> None:
    scene = Scene(roads=(Road(points=((0.0, 0.0), (1.0, 0.0)), width_m=-1.0),))
    with pytest.raises(BadConfig, match="width_m"):
        World([VehicleSpec(camera=CameraSpec())], scene=scene)


def test_cameras_and_pads_by_names() -> None:
    world = World(copters=2, rovers=1, cameras={"quad2": CameraSpec(width=320)}, pads={"rover1": PadSpec(size_m=0.7)})
    assert world.camera("quad2").spec.width == 320
    assert [vehicle.spec.pad for vehicle in world.vehicles] == [None, None, PadSpec(size_m=0.7)]
    with pytest.raises(BadInput, match="quad1 has no camera; these have: quad2"):
        world.camera("quad1")
    world.close()
    with pytest.raises(BadConfig, match="one of quad1, rover1"):
        World(copters=1, rovers=1, cameras={"quad9": CameraSpec()})


def test_a_vehicle_that_a_real_autopilot_flies_has_a_camera_and_is_seen() -> None:
    real = VehicleSpec(name="real", stack=Stack(), camera=CameraSpec(), pad=PadSpec(), start_ned_m=(4.0, 5.0, 0.0))
    own = VehicleSpec(name="own", camera=CameraSpec(), start_ned_m=(4.0, 4.0, 0.0))
    world = World([real, own], externals=Externals, epoch_s=0.0)
    assert world.camera("real").frame().position == pytest.approx((4.0, 5.0, -0.1))
    assert world.camera("own").frame().position == pytest.approx((4.0, 4.0, -0.1))
    world.close()


def test_a_world_without_cameras() -> None:
    world = World(copters=1)
    assert world.cameras is None
    with pytest.raises(BadInput, match="no vehicle has a camera"):
        world.camera("quad1")
    world.close()
