"""What ``zmav up``, ``zmav router`` and ``zmav mesh config`` do alike: which options they have, and how they plan."""

from __future__ import annotations

import platform
import re
from collections.abc import Callable
from typing import Any, TypeVar

import click

from mesh.plan import RouterPlan, plan_router
from zmav.config import load_fleet
from zmav.errors import BadConfig
from zmav.session import SessionSettings
from zmav.trust.credentials import Credentials

F = TypeVar("F", bound=Callable[..., Any])

file_option = click.option("--file", "fleet_file", metavar="FILE", help="Fleet file (TOML) with this host's table.")
insecure_option = click.option(
    "--insecure",
    is_flag=True,
    help="Reach beyond this computer without credentials: anyone who hears the network commands the fleet.",
)


def plan_host(
    fleet_file: str | None,
    name: str | None,
    settings: SessionSettings,
    *,
    fleet: str | None = None,
    insecure: bool = False,
    vehicle: bool = False,
) -> RouterPlan:
    """This computer's router as the options ask for it; raises what :func:`plan_router` and :func:`load_fleet` do, and
    :class:`BadConfig` for another mode than a router's.
    """
    if settings.mode not in (None, "router"):
        text = f"-m {settings.mode}: what is opened here is a router, for all on this computer; leave -m out"
        raise BadConfig(text, field="mode", value=settings.mode, expected="router")
    file = load_fleet(fleet_file) if fleet_file else None
    return plan_router(file, own_name(name, settings), settings, fleet=fleet, insecure=insecure, vehicle=vehicle)


def own_name(name: str | None, settings: SessionSettings) -> str:
    """The host's name: as given, else the certificate's, else the computer's own, made fit for a key."""
    if name is not None:
        return name
    if settings.credentials:
        return Credentials.load(settings.credentials).name
    return re.sub(r"[^a-z0-9_-]+", "-", platform.node().lower()) or "router"
