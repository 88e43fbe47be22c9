"""The compose files of ``deploy/containers`` as Docker would read them, as far as they can be without it."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import pytest

CONTAINERS = Path(__file__).resolve().parents[2] / "deploy" / "containers"
FILES = {"compose.yaml": "fleet.toml", "compose.sitl.yaml": "sitl.toml"}
"""compose file -> the fleet file that its services read"""
GIVEN = {"ZMAV_HTTP_TOKEN": "a-token-of-the-tests"}
"""what has no default, and must be set before anything starts"""
_REQUIRED = re.compile(r"\$\{(\w+):\?[^}]*\}")
_VARIABLE = re.compile(r"\$\{(\w+):-([^}]*)\}")


def load(name: str) -> dict[str, Any]:
    """A compose file with its defaults in place of variables; skips without PyYAML, which zmav does not need."""
    yaml = pytest.importorskip("yaml", reason="needs PyYAML")
    text = _REQUIRED.sub(lambda match: GIVEN[match[1]], (CONTAINERS / name).read_text(encoding="utf-8"))
    found: dict[str, Any] = yaml.safe_load(_VARIABLE.sub(lambda match: match[2], text))
    return found


def ours(file: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The services that run zmav's own image."""
    return {name: service for name, service in file["services"].items() if service["image"].startswith("zmav:")}


def option(command: list[str], name: str) -> str | None:
    """What follows an option in a command."""
    return command[command.index(name) + 1] if name in command else None


def network_of(file: dict[str, Any], service: str) -> str:
    """The service in whose network a service is."""
    mode = file["services"][service].get("network_mode", "")
    return str(mode.removeprefix("service:")) or service


def addresses(file: dict[str, Any]) -> dict[str, dict[str, str]]:
    """network -> service -> its fixed address there."""
    found: dict[str, dict[str, str]] = {}
    for name, service in file["services"].items():
        networks = service.get("networks") or {}
        for network in networks:
            at = networks[network] if isinstance(networks, dict) else None
            if at:
                found.setdefault(network, {})[name] = at["ipv4_address"]
    return found


def plain(**more: str) -> dict[str, str]:
    """Our environment without what would lead a zmav somewhere else."""
    return {name: value for name, value in os.environ.items() if not name.startswith("ZMAV_")} | more
