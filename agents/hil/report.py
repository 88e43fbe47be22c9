"""What a stage found, as it is kept: a JSON document with the hash of what was flown."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Literal

import msgspec

from zmav.config import FleetConfig
from zmav.errors import BadConfig
from zmav.mavlink.paramvalue import Value

Stage = Literal["sil", "bench"]
Status = Literal["ok", "BAD", "left out"]
NETWORK = ("link", "listen", "connect", "mesh", "sim")
"""of a vehicle's table, what does not change how it flies"""


class Check(msgspec.Struct, frozen=True):
    """One line: what was looked at, and what was found; ``left out``: it could not be tried, and why."""

    name: str
    status: Status
    found: str


class Identity(msgspec.Struct, frozen=True):
    """Which autopilot it was."""

    autopilot: str
    kind: str
    firmware: str | None
    uid: str | None
    sysid: int | None


class Report(msgspec.Struct, kw_only=True, forbid_unknown_fields=True):
    """One flight of a stage. ``flown_by``: a simulator or a device; ``proof``: why it was taken for a simulation."""

    stage: Stage
    fleet: str
    vehicle: str
    fleet_hash: str
    """:func:`hash_of` the fleet file's content for this vehicle"""
    zmav: str
    t: float
    """UTC seconds of its beginning"""
    flown_by: str
    proof: list[str] = []
    identity: Identity | None = None
    checks: list[Check] = []
    params: dict[str, Value] = {}
    """the autopilot's, as it was flown"""
    passed: bool = False


def hash_of(file: FleetConfig, name: str) -> str:
    """SHA-256 (hexadecimal) of what the fleet file says of how that vehicle is flown: its own table with the fleet's
    filled in, fleet, name, origin and separation. Links, network and simulation may differ from stage to stage.
    """
    table = msgspec.to_builtins(file.vehicle(name))
    flown = {key: value for key, value in table.items() if key not in NETWORK}
    whole = {"fleet": file.fleet, "name": name, "vehicle": flown}
    whole |= {"origin": msgspec.to_builtins(file.origin), "separation": msgspec.to_builtins(file.separation)}
    return hashlib.sha256(msgspec.json.encode(whole, order="deterministic")).hexdigest()


def place(folder: Path, name: str, stage: Stage) -> Path:
    """Where a vehicle's report of a stage is."""
    return folder / f"{name}-{stage}.json"


def keep(report: Report, folder: Path) -> Path:
    """Write it, as ``NAME-STAGE.json``; raises :class:`BadConfig` where that cannot be."""
    path = place(folder, report.vehicle, report.stage)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path.write_bytes(msgspec.json.format(msgspec.json.encode(report)))
    except OSError as e:
        text = f"cannot write the report {path}: {e.strerror}"
        raise BadConfig(text, field="reports", value=str(folder), expected="a folder to write to") from e
    return path


def find(folder: Path, name: str, stage: Stage) -> Report | None:
    """That report; None: there is none. Raises :class:`BadConfig` for one that cannot be read."""
    path = place(folder, name, stage)
    try:
        return msgspec.json.decode(path.read_bytes(), type=Report)
    except FileNotFoundError:
        return None
    except (OSError, msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as e:
        raise BadConfig(f"{path} is no report: {e}", field="reports", value=str(path), expected="a report") from e
