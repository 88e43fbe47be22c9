"""What ``zmav up``, ``zmav router`` and ``zmav mesh config`` ask alike: the fleet file, the host's name, and safety."""

from __future__ import annotations

import platform
import re
from collections.abc import Callable
from typing import Any, TypeVar

import click

from zmav.session import SessionSettings
from zmav.trust.credentials import Credentials

F = TypeVar("F", bound=Callable[..., Any])

file_option = click.option("--file", "fleet_file", metavar="FILE", help="Fleet file (TOML) with this host's table.")
insecure_option = click.option(
    "--insecure", is_flag=True,
    help="Reach beyond this computer without credentials: whoever hears the network commands the fleet.",
)  # fmt: skip


def own_name(name: str | None, settings: SessionSettings) -> str:
    """The host's name: as given, else the certificate's, else the computer's own, made fit for a key."""
    if name is not None:
        return name
    if settings.credentials:
        return Credentials.load(settings.credentials).name
    return re.sub(r"[^a-z0-9_-]+", "-", platform.node().lower()) or "router"
