"""``zmav sim`` itself: its options, other people's autopilots among them, the world they make, and its run."""

from __future__ import annotations

import contextlib
import functools
import os
import resource
import signal
import sys
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import click
import msgspec

from zmav.cli.common import Finite
from zmav.errors import BadConfig, BadInput
from zmav.hil.binaries import ARDUPILOT_PROGRAMS
from zmav.hil.externals import Externals
from zmav.process import say
from zmav.sim import DEFAULT_READY_S, REALISTIC_READY_S, SimVehicle, World
from zmav.sim.camera import CameraSpec, PadSpec, load_scene
from zmav.sim.external import External
from zmav.sim.fleetfile import FleetFile, WorldTable, load_simulated, speed_of
from zmav.sim.lineup import KINDS, field_of
from zmav.sim.listener import Listener
from zmav.sim.remote import control_path
from zmav.sim.sensors.noise import PROFILES
from zmav.sim.spec import ARDUCOPTER, PX4, Stack, VehicleSpec, airframe_of
from zmav.sim.values import parse_home, parse_speed, parse_wind

MOST = 250
_KIND_OF_PROGRAM = dict(zip(ARDUPILOT_PROGRAMS, ("copter", "rover", "plane"), strict=True))

STACK_OPTIONS = (
    click.option(
        "--px4",
        multiple=True,
        metavar="COUNT|PATH",
        help="How many PX4 quadrotors; with the path of a PX4 build (or its px4 program), that flies them.",
    ),
    click.option(
        "--ardupilot",
        metavar="PATH",
        help="Have a real ArduPilot fly the copters, rovers and planes: a source or build tree, or one SITL program.",
    ),
    click.option(
        "--hil",
        "devices",
        multiple=True,
        metavar="DEVICE[:BAUD]",
        help="A vehicle for a real PX4 in HITL mode on a serial line; its MAVLink is passed on; repeatable.",
    ),
    click.option("--keep", metavar="DIR", help="Keep their files (parameters, logs, output) in DIR/NAME."),
)


def flown_by(vehicles: Sequence[VehicleSpec], options: dict[str, Any]) -> tuple[list[VehicleSpec], dict[str, Any]]:
    """A fleet file's vehicles as the programs of ``--ardupilot`` and ``--px4 PATH`` fly them, and what is left of the
    options. A PX4 flies the copters of a fleet that has no PX4. :class:`BadConfig` for a program that has none to fly.
    """
    path, count = _px4(options["px4"])
    programs = {"px4": path, "ardupilot": options["ardupilot"]}
    if not vehicles or not any(programs.values()):
        return list(vehicles), options
    if path is not None and not any(spec.autopilot == PX4 for spec in vehicles):
        vehicles = [_as_px4(spec) if spec.autopilot == ARDUCOPTER else spec for spec in vehicles]
    found = []
    for spec in vehicles:
        kind = "px4" if spec.autopilot == PX4 else "ardupilot"
        program = programs[kind]
        if program is not None and spec.stack is None:
            spec = _with(spec, program=program, directory=options["keep"])
        found.append(spec)
    for kind, program in programs.items():
        if program and not any((spec.autopilot == PX4) == (kind == "px4") for spec in vehicles):
            raise _bad(kind, program, "a vehicle of that autopilot in the fleet file")
    return found, {**options, "ardupilot": None, "px4": (str(count),) if count else ()}


def stack_vehicles(counts: dict[str, int], options: dict[str, Any]) -> list[VehicleSpec]:
    """The vehicles of :data:`STACK_OPTIONS`; ``counts``, by kind, loses those that a program flies. Gives its px4."""
    px4_path, counts["px4"] = _px4(options["px4"])
    found: list[VehicleSpec] = []
    if options["ardupilot"] is not None:
        found += _flown(counts, options["ardupilot"], options["keep"])
    if px4_path is not None:
        number = counts["px4"] or 1
        counts["px4"] = 0
        found += [_with(KINDS["px4"], program=px4_path, directory=options["keep"])] * number
    found += [_with(KINDS["px4"], device=device) for device in options["devices"]]
    return found


def _as_px4(spec: VehicleSpec) -> VehicleSpec:
    """The same copter at its place, with what it carries; PX4's programs choose their own ports."""
    return msgspec.structs.replace(spec, autopilot=PX4, airframe=airframe_of(spec), endpoints=(), params={})


def _with(spec: VehicleSpec, **stack: Any) -> VehicleSpec:
    return msgspec.structs.replace(spec, stack=Stack(**stack))


def _px4(words: Sequence[str]) -> tuple[str | None, int]:
    """``--px4`` given some times: a path, and a count."""
    path, count = None, 0
    for word in words:
        if word.isdigit():
            count += int(word)
        elif path is None:
            path = word
        else:
            raise _bad("px4", word, "one path")
    if count > MOST:
        raise _bad("px4", str(count), f"at most {MOST}")
    return path, count


def _flown(counts: dict[str, int], path: str, directory: str | None) -> list[VehicleSpec]:
    """ArduPilots as counted; where nothing is, one of what the program is for."""
    kinds = ("copter", "hexa", "rover", "plane")
    if not any(counts[kind] for kind in kinds):
        counts[_KIND_OF_PROGRAM.get(Path(path).name, "copter")] = 1
    found = [_with(KINDS[kind], program=path, directory=directory) for kind in kinds for _ in range(counts[kind])]
    for kind in kinds:
        counts[kind] = 0
    return found


def _bad(option: str, value: str, expected: str) -> BadConfig:
    return BadConfig.wrong(option, value, expected, f"--{option} {value}")


F = TypeVar("F", bound=Callable[..., Any])
COUNT = click.IntRange(0, 250)
CAMERA_PORT = 8554

_OPTIONS = (
    click.option(
        "--fleet",
        "fleet_file",
        metavar="FILE",
        help="Fleet file (TOML), the one that 'zmav up --file' reads: its vehicles with a sim table, and its world.",
    ),
    click.option(
        "--free-ports", is_flag=True, help="Its vehicles at any free TCP ports, not where its links say: see 'status'."
    ),
    click.option("--copters", type=COUNT, help="How many ArduCopters.  [default: 1 where nothing else is asked for]"),
    click.option("--hexas", default=0, type=COUNT, help="How many ArduCopters on hexarotors."),
    click.option("--rovers", default=0, type=COUNT, help="How many ArduRovers."),
    click.option("--planes", default=0, type=COUNT, help="How many ArduPlanes."),
    *STACK_OPTIONS,
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
        default=CAMERA_PORT,
        show_default=True,
        help="Where pictures are served on loopback; 0: any free port.",
    ),
    click.option(
        "--endpoint",
        "endpoints",
        multiple=True,
        metavar="ENDPOINT",
        help="Where each is reached: ardupilot (TCP 5760, 5762 and 5763, +10·i), tcp:PORT+STEP, udp:HOST:PORT+STEP, "
        "px4 (14580+i to 14540+i and 18570+i to 14550), pty:PATH and others; repeatable.  "
        "[default: ardupilot or px4]",
    ),
    click.option("--home", metavar="LAT,LON,AMSL,HEADING", help="Where the first stands, degrees and m."),
    click.option("--spacing", type=Finite(), metavar="M", help="Metres between starts.  [default: 10]"),
    click.option(
        "--wind",
        metavar="SPEED[@FROM][,GUSTS]",
        help="m/s, the degrees it comes from (270: from the west, the default), and gusty, light, moderate or severe.",
    ),
    click.option("--noise", type=click.Choice(list(PROFILES)), help="Of the sensors.  [default: none]"),
    click.option("--speed", metavar="TIMES", help="Times real time; 0 or max: as fast as it goes.  [default: 1]"),
    click.option("--lockstep", is_flag=True, help="Wait for clients that answer TIMESYNC, as 'zmav up' does."),
    click.option("--seed", type=int, help="Two worlds of one seed are identical.  [default: 0]"),
    click.option(
        "--up",
        is_flag=True,
        help="Start a 'zmav up' beside each, and a router where 'zmav ls' and others look for one.",
    ),
    click.option(
        "--control", metavar="PATH", help="The control socket: a path or a name.  [default: called after the process]"
    ),
)


def run_options(command: F) -> F:
    """What a world can be told when it begins."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def run_world(control: str | None, camera_port: int, up: bool, **options: Any) -> None:
    """Make the world, with ``up`` in the key space, and run it until SIGTERM, SIGINT or 'zmav sim stop'."""
    path = control_path(control)
    world = make_world(**options)
    before = {each: signal.signal(each, lambda *_: world.stop()) for each in (signal.SIGTERM, signal.SIGINT)}
    listener = None
    try:
        _allow_files()
        world.open()
        listener = Listener(path, world)
        serve_cameras(world, camera_port)
        announce(world)
        world.say = say
        world.on_failure = lambda vehicle, error: say(_obituary(vehicle, error))
        with contextlib.ExitStack() as stack:
            if up:
                from zmav.cli.sim.up import companions  # with sessions, which the others need not load

                stack.enter_context(companions(world, options["fleet_file"]))
            world.run()
        if world.failures:
            world.failures.clear()
            sys.exit(1)
    finally:
        if listener is not None:
            listener.close()
        world.close()
        for number, handler in before.items():
            signal.signal(number, handler)


def make_world(
    fleet_file: str | None,
    copters: int | None,
    hexas: int,
    rovers: int,
    planes: int,
    endpoints: tuple[str, ...],
    home: str | None,
    spacing: float | None,
    wind: str | None,
    noise: str | None,
    speed: str | None,
    lockstep: bool,
    seed: int | None,
    cameras: tuple[str, ...],
    pads: tuple[str, ...],
    scene: str | None,
    free_ports: bool = False,
    **stacks: Any,
) -> World:
    """The world that these options ask for: what they do not say, the fleet file says, or a default."""
    file = load_simulated(fleet_file) if fleet_file else FleetFile(WorldTable(), None, None, [])
    counts = {"copter": copters or 0, "hexa": hexas, "rover": rovers, "plane": planes}
    ours, stacks = flown_by(file.vehicles, stacks)
    if free_ports:
        ours = [msgspec.structs.replace(spec, endpoints=("tcp:0",)) for spec in ours]
    vehicles = [*ours, *stack_vehicles(counts, stacks)]
    if copters is None and not vehicles and not any(counts.values()):
        counts["copter"] = 1
    given = {"wind": wind, "noise": noise, "speed": parse_speed(speed) if speed else None, "seed": seed}
    given |= {"spacing_m": spacing, "lockstep": lockstep or None}
    said = {name: value for name, value in given.items() if value is not None}
    table = msgspec.structs.replace(file.world, **said)
    blows, gusts = parse_wind(table.wind)
    return World(
        vehicles,
        **{field_of(kind): counts[kind] for kind in KINDS},
        home=parse_home(home) if home else file.home,
        spacing_m=table.spacing_m,
        endpoint=endpoints or None,
        speed=speed_of(table),
        lockstep=table.lockstep,
        seed=table.seed,
        wind=blows,
        gusts=gusts,
        noise=table.noise,
        scene=file.scene if scene is None else load_scene(scene),
        tick_hz=table.tick_hz,
        cameras=dict(map(parse_camera, cameras)),
        pads={name: PadSpec() for name in pads},
        ready_s=REALISTIC_READY_S if table.real_boot else DEFAULT_READY_S,
        externals=functools.partial(Externals, say=say),
    )


def parse_camera(text: str) -> tuple[str, CameraSpec]:
    """``NAME[:RATE]``; :class:`BadInput` for anything else."""
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


def _allow_files() -> None:
    """As many open files as this user may have: a fleet of hundreds has a thousand sockets."""
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))


def announce(world: World) -> None:
    """Say where each vehicle is reached; nobody need be there to read it."""
    try:
        reached: list[SimVehicle | External] = [*world.vehicles, *world.externals.vehicles]
        for vehicle in reached:
            click.echo(f"{vehicle.name} (system id {vehicle.sysid}): {' '.join(vehicle.urls)}")
        sys.stdout.flush()
    except OSError:  # the reader has gone: what is buffered would fail again at the exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)


def _obituary(vehicle: SimVehicle, error: Exception) -> str:
    told = "".join(traceback.format_exception(error)).rstrip()
    return (
        f"{told}\n{vehicle.name} has failed by a defect of the simulator; its autopilot is dead, the others go on. "
        "Please report the lines above."
    )
