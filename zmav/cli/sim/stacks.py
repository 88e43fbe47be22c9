"""The options of ``zmav sim`` for other people's autopilots: their programs, their hardware, and those that connect."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
import msgspec

from zmav.errors import BadConfig
from zmav.hil.binaries import ARDUPILOT_PROGRAMS
from zmav.sim.lineup import KINDS
from zmav.sim.spec import ARDUCOPTER, PX4, Stack, VehicleSpec

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
    """The copter at its place, with what it carries; PX4's programs fly one airframe, and choose their own ports."""
    return msgspec.structs.replace(spec, autopilot=PX4, airframe=None, endpoints=(), params={})


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
