"""``zmav swarm survey``: pictures of an area for a map, by the figures that planners of single flights ask for."""

from __future__ import annotations

import math
import re
from pathlib import Path

import click
import msgspec

from agents.planner.cli.goals import (
    POLYGON,
    Make,
    above_ground_option,
    degrees,
    goal_options,
    one_height,
    polygon,
    vehicles_argument,
)
from zmav.wire import swarm

NUMBER = r"(\d+(?:\.\d+)?)"
SENSOR = re.compile(rf"{NUMBER}x{NUMBER}/{NUMBER}")
ANGLES = re.compile(rf"{NUMBER}x{NUMBER}deg")
CAMERA, OVERLAPS = "WxH/FOCAL|WxHdeg|FILE", "FRONT,SIDE"
FORMS = "a sensor over a focal length in mm (13.2x8.8/8.8), a field of view (73.7x53.1deg) or a calibration file"


class Lens(msgspec.Struct):
    """What a survey needs of a calibration file: see docs/camera.md."""

    width: int
    height: int
    focal: tuple[float, float]


def camera(text: str) -> tuple[float, float, int]:
    """m of ground in a picture from 1 m above, across and along the way, and its pixels across; 0: not known.

    The picture's long side lies across the way.
    """
    pixels = 0
    if found := SENSOR.fullmatch(text):
        wide, high, focal = map(float, found.groups())
        ratios = [wide / focal, high / focal] if focal else []
    elif found := ANGLES.fullmatch(text):
        angles = [math.radians(float(each)) for each in found.groups()]
        ratios = [2.0 * math.tan(each / 2.0) for each in angles] if max(angles) < math.pi else []
    else:
        lens = _lens(Path(text))
        pixels = max(lens.width, lens.height)
        ratios = [size / focal for size, focal in zip((lens.width, lens.height), lens.focal, strict=True) if focal > 0]
    if len(ratios) < 2 or min(ratios) <= 0.0:
        raise click.BadParameter(f"no picture comes of {text!r}: give {FORMS}")
    return max(ratios), min(ratios), pixels


def _lens(path: Path) -> Lens:
    decode = msgspec.json.decode if path.suffix == ".json" else msgspec.toml.decode
    try:
        return decode(path.read_bytes(), type=Lens)
    except (OSError, ValueError, msgspec.MsgspecError) as e:
        why = e.strerror if isinstance(e, OSError) else e
        raise click.BadParameter(f"{str(path)!r} is not {FORMS}: {why}") from e


def overlaps(text: str) -> tuple[float, float]:
    """``FRONT,SIDE``, or one for both."""
    parts = text.split(",")
    try:
        shares = [float(part) for part in parts]
    except ValueError:
        shares = []
    if len(shares) not in (1, 2) or not all(0.0 <= share <= 0.9 for share in shares):
        raise click.BadParameter(f"{text!r} is not {OVERLAPS}: shares of a picture from 0 to 0.9, such as 0.75,0.65")
    return shares[0], shares[-1]


@click.command("survey")
@vehicles_argument
@click.option("--polygon", type=polygon, metavar=POLYGON, required=True, help="The area: '0,0 100,0 100,80'.")
@click.option("--camera", "lens", type=camera, metavar=CAMERA, required=True, help=f"{FORMS[0].upper()}{FORMS[1:]}.")
@click.option("--pixels", type=click.IntRange(min=1), help="Of a picture's long side, for --gsd.")
@click.option("--height", type=float, help="Metres above where each took off.")
@above_ground_option
@click.option("--gsd", type=float, help="Centimetres of ground a pixel, in place of --height.")
@click.option("--overlap", type=overlaps, metavar=OVERLAPS, default="0.75,0.65", show_default=True)
@degrees("--heading", help="Degrees clockwise from north of the lanes.  [default: along a side, the quickest]")
@click.option("--trigger", is_flag=True, help="Each autopilot triggers its camera by distance over the lanes.")
@goal_options
def survey(
    vehicles: tuple[str, ...],
    polygon: list[swarm.Corner],
    lens: tuple[float, float, int],
    pixels: int | None,
    height: float | None,
    above_ground: float | None,
    gsd: float | None,
    overlap: tuple[float, float],
    heading: float | None,
    trigger: bool,
) -> Make:
    """Photograph an area for a map, split between the vehicles: 'quad* --polygon ... --camera 13.2x8.8/8.8 --gsd 2'.

    --preview tells time, way, pictures and battery of each. Without --trigger nobody triggers the cameras: they do so
    by themselves, or 'zmav do quad1 camera_trigger distance=METRES' has the autopilot do it.
    """
    across, along, known = lens
    pixels = pixels or known
    if (height is not None) + (gsd is not None) + (above_ground is not None) != 1:
        raise click.UsageError("how high? give one of --height, --above-ground and --gsd")
    if gsd is not None:
        if not pixels:
            raise click.UsageError("--gsd needs --pixels, or a camera that says its own")
        height = gsd / 100.0 * pixels / across
    height, follows = one_height(height, above_ground, "--height")
    if not (math.isfinite(height) and height > 0.0):
        raise click.UsageError("a survey is flown above the ground: a height or ground sample distance above 0")
    goal = swarm.Survey(
        vehicles=[],
        polygon=polygon,
        height=height,
        above_ground=follows,
        angle=heading,
        camera=(across, along),
        front=overlap[0],
        overlap=overlap[1],
        pixels=pixels,
        trigger=trigger,
    )
    return lambda planner: msgspec.structs.replace(goal, vehicles=planner.names(vehicles))
