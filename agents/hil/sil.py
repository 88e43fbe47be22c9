"""The first stage: the fleet file's vehicle in the simulator, under the embedded autopilot or a real one's program."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import click
import msgspec

from agents.hil.beside import begun, beside, closing, tell
from agents.hil.checkflight import CheckFlight
from zmav.children import Children, simulator_once_up
from zmav.config import FleetConfig, load_fleet
from zmav.config.table import toml_document
from zmav.errors import BadConfig


async def sil(path: Path, name: str, reports: Path, *, ardupilot: str | None = None, px4: str | None = None) -> int:
    """Fly the check flight there; 0 where it passed. ``ardupilot``, ``px4``: the program that flies it, or its tree."""
    file = load_fleet(path)
    file.vehicle(name)
    by, program = "the embedded simulator", tuple[str, ...]()
    for option, stack, given in (("--ardupilot", "ArduPilot", ardupilot), ("--px4", "PX4", px4)):
        if given:
            by, program = f"{stack} SITL ({given})", (option, str(Path(given).expanduser().absolute()))
    with Children() as children:
        simulated, control = children.folder / "simulated.toml", children.folder / "control"
        simulated.write_text(alone(file, name), encoding="utf-8")
        where = ("--fleet", str(simulated), "--control", str(control), "--free-ports")
        children.start("simulator", "sim", *where, *program)
        report = begun("sil", file, name, by)
        click.echo(f"sil: {file.fleet}/{name} from {path}, flown by {by}")
        with closing(report, reports), await simulator_once_up(control, children.check) as simulator:
            link = simulator.status().vehicles[0].url
            hurry: Callable[[float], object] | None = None if program else simulator.speed
            radio = None if program else lambda channel, pwm: simulator.pilot(name, None, {channel: pwm})
            async with beside(children, path, file, name, link) as (client, router):
                flight = CheckFlight(client, file, name, router, children, report, tell, hurry, radio)
                await flight.meet()
                await flight.fly()
        return 0 if report.passed else 1


def alone(file: FleetConfig, name: str) -> str:
    """A fleet file (TOML) with that vehicle alone, as it is simulated: a copter where it has no table ``sim``."""
    table = file.vehicle(name)
    if table.signing is not None:
        text = f"vehicles.{name}.signing is for the autopilot that has the key: the simulator has none"
        raise BadConfig(text, field=f"vehicles.{name}.signing", expected="a vehicle without signing for SIL")
    given = {key: value for key, value in (table.sim or {}).items() if key != "endpoints"}
    world = {key: value for key, value in file.sim.items() if key not in ("speed", "lockstep", "scene")}
    origin = {"origin": msgspec.to_builtins(file.origin)} if file.origin else {}
    sysid = {"sysid": table.sysid} if table.sysid is not None else {}
    vehicle = {"link": "tcp:127.0.0.1:5760", "sim": given, **sysid}
    return toml_document({**origin, "sim": world, "vehicles": {name: vehicle}})
