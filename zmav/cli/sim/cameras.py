"""The options of ``zmav sim`` for cameras, what they see, and where their pictures are served."""

from __future__ import annotations

import click

from zmav.errors import BadInput
from zmav.sim import World
from zmav.sim.camera import CameraSpec

DEFAULT_PORT = 8554

CAMERA_OPTIONS = (
    click.option(
        "--camera",
        "cameras",
        multiple=True,
        metavar="NAME[:RATE]",
        help="A downward camera on that vehicle, at so many Hz (20), served as HTTP; repeatable.",
    ),
    click.option("--pad", "pads", multiple=True, metavar="NAME", help="A landing pad on that vehicle; repeatable."),
    click.option("--scene", metavar="FILE", help="What cameras see: a scene file (TOML)."),
    click.option(
        "--camera-port",
        type=click.IntRange(0, 65535),
        default=DEFAULT_PORT,
        show_default=True,
        help="Where pictures are served on loopback; 0: any free port.",
    ),
)


def parse_cameras(texts: tuple[str, ...]) -> dict[str, CameraSpec]:
    """By vehicles' names; :class:`BadInput` for what is not ``NAME[:RATE]``."""
    return dict(_parse(text) for text in texts)


def _parse(text: str) -> tuple[str, CameraSpec]:
    name, colon, rate = text.partition(":")
    try:
        hz = float(rate) if colon else CameraSpec().rate_hz
    except ValueError:
        hz = 0.0
    if not name or not 0.0 < hz <= 100.0:
        expected = "NAME or NAME:RATE, the rate above 0 and up to 100 Hz"
        raise BadInput.wrong("camera", text, expected, f"--camera {text}")
    return name, CameraSpec(rate_hz=hz)


def serve_cameras(world: World, port: int) -> None:
    """Serve them, where there are any, and say where."""
    if world.cameras is not None:
        from zmav.sim.camera import serve  # with OpenCV

        for name, url in serve.serve_cameras(world.cameras, port).items():
            click.echo(f"{name} camera: {url}")
