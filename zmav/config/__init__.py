"""The fleet file: TOML, typed and strict, one for the whole fleet. :mod:`zmav.config.fleet` shows what it holds."""

from __future__ import annotations

from zmav.config.body import BodyConfig, body_of, check_body
from zmav.config.fleet import (
    Action,
    Failsafe,
    FleetConfig,
    Geofence,
    Limits,
    PilotSwitch,
    Rights,
    Separation,
    Signing,
    StationConfig,
    VehicleConfig,
    check_failsafe,
    check_fence,
    load_fleet,
    origin_of,
    usual_fence,
    usual_limits,
)
from zmav.config.mesh import COST, Address, Host, Mesh, Profile, Radio, RadioKind
from zmav.config.table import Table

__all__ = [
    "COST",
    "Action",
    "Address",
    "BodyConfig",
    "Failsafe",
    "FleetConfig",
    "Geofence",
    "Host",
    "Limits",
    "Mesh",
    "PilotSwitch",
    "Profile",
    "Radio",
    "RadioKind",
    "Rights",
    "Separation",
    "Signing",
    "StationConfig",
    "Table",
    "VehicleConfig",
    "body_of",
    "check_body",
    "check_failsafe",
    "check_fence",
    "load_fleet",
    "origin_of",
    "usual_fence",
    "usual_limits",
]
