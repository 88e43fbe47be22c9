"""Nothing leaves loopback unguarded: which endpoints others can reach, and what those need.

Without credentials a router neither knows nor judges who speaks to it, so it speaks with its own host only. With them,
``tls/`` and ``quic/`` ask for a certificate at both ends; the other protocols ask for nothing.
"""

from __future__ import annotations

import json
import re
import socket
from collections.abc import Iterable, Iterator
from typing import Any

import zenoh

from mesh.endpoint import host_port
from zmav.errors import BadConfig
from zmav.links.sockets import is_loopback

GUARDED = ("tls", "quic")
"""protocols on which both ends show a certificate"""
LOCAL = ("unixsock-stream", "unixpipe")
"""protocols that do not leave the computer"""
GUARDS = ("transport/link/tls", "access_control")
"""what the credentials set of Zenoh's configuration; nothing else may, where others can be at the other end"""
UNGUARDED = re.compile(r"[#;](enable_mtls|root_ca|listen_|connect_)")
"""in an endpoint: what would take the place of our certificates on that endpoint alone"""


def check_opened(opened: zenoh.Config, ours: zenoh.Config, credentials: object, insecure: bool) -> None:
    """Raise :class:`BadConfig` for what ``opened``, all that a router is opened with, would let in unguarded.

    ``ours`` is the same without what a person gave on top: with credentials, their guards are as they stand there.
    """
    reached = [*_endpoints(opened, "listen/endpoints"), *_endpoints(opened, "connect/endpoints")]
    scouting = bool(json.loads(opened.get_json("scouting/multicast/enabled")))
    check_exposed(reached, credentials, insecure, scouting=scouting)
    if insecure or credentials is None or not (scouting or any(map(is_exposed, reached))):
        return
    for path in GUARDS:
        if opened.get_json(path) != ours.get_json(path):
            raise _refusal(path, "it was given in another way than the credentials do", "leave it to them")


def _endpoints(opened: zenoh.Config, path: str) -> list[str]:
    """Zenoh also takes them by the mode of who opens."""
    return list(_texts(json.loads(opened.get_json(path))))


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict | list):
        for each in value.values() if isinstance(value, dict) else value:
            yield from _texts(each)


def check_exposed(endpoints: Iterable[str], credentials: object, insecure: bool, *, scouting: bool = False) -> None:
    """Raise :class:`BadConfig` where an endpoint, listened on or connected to, or multicast scouting, would reach
    beyond loopback without a certificate being asked for.

    ``credentials`` is what the router has, or None; ``insecure`` allows everything. A name is looked up, and counts as
    beyond loopback unless all of its addresses are of loopback.
    """
    if insecure:
        return
    for endpoint in endpoints:
        protocol = endpoint.partition("/")[0]
        guarded = protocol in GUARDED and not UNGUARDED.search(endpoint)
        if not is_exposed(endpoint) or (credentials is not None and guarded):
            continue
        if credentials is None:
            raise _refusal(
                endpoint, "there are no credentials", "give --credentials DIR ('zmav mesh ca issue' makes it)"
            )
        asks = f"{protocol}/ asks nobody for a certificate" if protocol not in GUARDED else "it brings its own guards"
        raise _refusal(endpoint, asks, "use quic/ or tls/ as the credentials set them")
    if scouting and credentials is None:
        what = "multicast scouting"
        raise _refusal(what, "there are no credentials", "give --credentials DIR ('zmav mesh ca issue' makes it)")


def is_exposed(endpoint: str) -> bool:
    """Whether others than this computer's own programs can be at the other end of a Zenoh endpoint."""
    return endpoint.partition("/")[0] not in LOCAL and not _is_local(host_port(endpoint)[0])


def _is_local(host: str) -> bool:
    try:
        found = {str(info[4][0]) for info in socket.getaddrinfo(host, None)}
    except (OSError, UnicodeError):
        return False
    return bool(found) and all(map(is_loopback, found))


def _refusal(what: str, why: str, advice: str) -> BadConfig:
    text = (
        f"{what} would let others in unguarded: {why}; {advice}, keep to loopback, or say --insecure "
        "([mesh] insecure = true) in a laboratory"
    )
    return BadConfig(text, field="endpoint", value=what, expected="loopback, or credentials and quic/ or tls/")
