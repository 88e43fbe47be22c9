"""What Zenoh's routers say of themselves in their admin space."""

from __future__ import annotations

import contextlib
from typing import Any

import msgspec

from zmav.client import Answer, Client


async def routers(z: Client) -> list[dict[str, Any]]:
    """Every router that answers: its id and its sessions; what is not to be read as that is left out."""
    found = []
    for answer in await z.ask("@/*/router", timeout=2.0):
        if isinstance(answer, Answer):
            with contextlib.suppress(msgspec.DecodeError, UnicodeDecodeError, RecursionError):
                found.append(_router(answer.key.split("/")[1], msgspec.json.decode(answer.payload, type=_Admin)))
    return found


class _Peer(msgspec.Struct):
    peer: str
    whatami: str
    links: list[dict[str, Any]] = []


class _Admin(msgspec.Struct):
    """What a router of Zenoh says of itself, as far as it is used here."""

    version: str = ""
    locators: list[str] = []
    sessions: list[_Peer] = []


def _router(zid: str, told: _Admin) -> dict[str, Any]:
    return {
        "zid": zid,
        "version": told.version.removeprefix("v").partition("-")[0],
        "locators": told.locators,
        "links": [
            {"peer": s.peer, "whatami": s.whatami, "links": [str(link.get("dst", link)) for link in s.links]}
            for s in told.sessions
        ],
    }
