"""SIL: the fleet file's vehicle in the simulator, under the embedded autopilot or a real one's program."""

from __future__ import annotations

import json
import socket
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from zmav.children import Children
from zmav.config import FleetConfig
from zmav.errors import BadConfig
from zmav.process import free_port
from zmav.sim.spec import PX4

USUAL: Mapping[str, dict[str, Any]] = {
    "copter": {"autopilot": "arducopter"},
    "hexa": {"autopilot": "arducopter", "airframe": "hexa"},
    "rover": {"autopilot": "ardurover"},
    "plane": {"autopilot": "arduplane"},
    "px4": {"autopilot": "px4"},
}
"""what is simulated for a vehicle whose table has no ``sim``, by ``--kind``"""
LAST_INSTANCE = 50


def start_simulator(
    children: Children, file: FleetConfig, name: str, *, kind: str, ardupilot: str | None, px4: str | None
) -> tuple[str, str, Path]:
    """Start ``zmav sim`` with that vehicle alone. Gives the link to it, who flies it, and the simulator's control.

    A program (``ardupilot``, ``px4``: where it is) gets the first instance whose ports are free.
    """
    table = file.vehicle(name)
    if table.signing is not None:
        text = f"vehicles.{name}.signing is for the autopilot that has the key: the simulator has none"
        raise BadConfig(text, field=f"vehicles.{name}.signing", expected="a vehicle without signing for SIL")
    given = {**(USUAL[kind] if table.sim is None else table.sim)}
    given.pop("endpoints", None)
    if px4:
        given = {"autopilot": PX4, "start_ned_m": given.get("start_ned_m", [0.0, 0.0, 0.0])}
    is_px4 = given.get("autopilot") == PX4
    if ardupilot and is_px4:
        text = f"{name} is simulated as a PX4, and --ardupilot is for another; give --px4 PATH, or change its sim table"
        raise BadConfig(text, field="ardupilot", value=ardupilot, expected="--px4 PATH")
    sysid, by, program = table.sysid, "the embedded simulator", ardupilot or px4
    link = f"udpin:127.0.0.1:{free_port(socket.SOCK_DGRAM)}" if is_px4 else f"tcp:127.0.0.1:{free_port()}"
    if program:
        instance = _free_instance(is_px4)
        sysid = instance + 1 if is_px4 else sysid
        given["stack"] = {"program": str(Path(program).expanduser().absolute()), "instance": instance}
        link = f"udpin:127.0.0.1:{14540 + instance}" if is_px4 else f"tcp:127.0.0.1:{5760 + 10 * instance}"
        by = f"{'PX4' if is_px4 else 'ArduPilot'} SITL ({program})"
    world = {key: value for key, value in file.sim.items() if key not in ("speed", "lockstep", "scene")}
    lines = [f"origin = {_toml(msgspec.to_builtins(file.origin))}"] if file.origin else []
    lines += [f"sim = {_toml(world)}", f"[vehicles.{name}]", f"link = {_toml(link)}", f"sim = {_toml(given)}"]
    lines += [f"sysid = {sysid}"] if sysid is not None else []
    path, control = children.folder / "simulated.toml", children.folder / "control"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    children.start("simulator", "sim", "--fleet", str(path), "--control", str(control))
    return link, by, control


def _toml(value: Any) -> str:
    """A value as TOML has it in one line."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{json.dumps(str(k))} = {_toml(v)}" for k, v in value.items() if v is not None) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return json.dumps(value)


def _free_instance(px4: bool) -> int:
    for i in range(LAST_INSTANCE if not px4 else 10):
        tcp = (4560 + i,) if px4 else (5760 + 10 * i, 5762 + 10 * i, 5763 + 10 * i)
        udp = (14540 + i, 14580 + i) if px4 else (9002 + 10 * i, 9003 + 10 * i, 5501 + 10 * i)
        if all(_is_free(port, socket.SOCK_STREAM) for port in tcp) and all(
            _is_free(port, socket.SOCK_DGRAM) for port in udp
        ):
            return i
    raise BadConfig("no instance of a SITL program has all its ports free", field="instance", expected="free ports")


def _is_free(port: int, kind: int) -> bool:
    with socket.socket(socket.AF_INET, kind) as s:
        if kind == socket.SOCK_STREAM:
            s.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            s.bind(("127.0.0.1", port))
        except OSError:
            return False
        return True
