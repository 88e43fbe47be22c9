"""The fleet file: TOML, typed and strict, one for the whole fleet. :mod:`zmav.config.fleet` shows what it holds."""

from __future__ import annotations

from zmav.config.body import BodyConfig, body_of, check_body
from zmav.config.camera import CameraConfig
from zmav.config.fleet import (
    RETURN_LEAD,
    Failsafe,
    FleetConfig,
    Geofence,
    Limits,
    PilotSwitch,
    Rights,
    Separation,
    Signing,
    StationConfig,
    Traffic,
    VehicleConfig,
    check_failsafe,
    load_fleet,
    origin_of,
    usual_fence,
    usual_limits,
)
from zmav.config.mesh import Address, Host, Profile, Radio

__all__ = [
    "RETURN_LEAD",
    "Address",
    "BodyConfig",
    "CameraConfig",
    "Failsafe",
    "FleetConfig",
    "Geofence",
    "Host",
    "Limits",
    "PilotSwitch",
    "Profile",
    "Radio",
    "Rights",
    "Separation",
    "Signing",
    "StationConfig",
    "Traffic",
    "VehicleConfig",
    "body_of",
    "check_body",
    "check_failsafe",
    "load_fleet",
    "origin_of",
    "usual_fence",
    "usual_limits",
]
