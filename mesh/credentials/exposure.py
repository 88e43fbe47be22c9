"""Nothing leaves loopback unguarded: which endpoints others can reach, and what those need.

Without credentials a router neither knows nor judges who speaks to it, so it speaks with its own host only. With them,
``tls/`` and ``quic/`` ask for a certificate at both ends; the other protocols ask for nothing.
"""

from __future__ import annotations

import ipaddress
import socket
from collections.abc import Iterable

from zmav.errors import BadConfig

GUARDED = ("tls", "quic")
"""protocols on which both ends show a certificate"""
LOCAL = ("unixsock-stream", "unixpipe")
"""protocols that do not leave the computer"""


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
        if not is_exposed(endpoint) or (credentials is not None and protocol in GUARDED):
            continue
        if credentials is None:
            raise _refusal(
                endpoint, "there are no credentials", "give --credentials DIR ('zmav mesh ca issue' makes it)"
            )
        raise _refusal(endpoint, f"{protocol}/ asks nobody for a certificate", "use quic/ or tls/")
    if scouting and credentials is None:
        what = "multicast scouting"
        raise _refusal(what, "there are no credentials", "give --credentials DIR ('zmav mesh ca issue' makes it)")


def is_exposed(endpoint: str) -> bool:
    """Whether others than this computer's own programs can be at the other end of a Zenoh endpoint."""
    protocol, _, rest = endpoint.partition("/")
    if protocol in LOCAL:
        return False
    address = rest.partition("?")[0].partition("#")[0]
    host = address.rpartition(":")[0] if ":" in address else address
    return not _is_loopback(host.strip("[]"))


def _is_loopback(host: str) -> bool:
    try:
        return _loops(host)
    except ValueError:
        pass  # a name
    try:
        found = {str(info[4][0]) for info in socket.getaddrinfo(host, None)}
    except (OSError, UnicodeError):
        return False
    return bool(found) and all(map(_loops, found))


def _loops(address: str) -> bool:
    parsed = ipaddress.ip_address(address)
    inner = parsed.ipv4_mapped if isinstance(parsed, ipaddress.IPv6Address) else None
    return (inner or parsed).is_loopback


def _refusal(what: str, why: str, advice: str) -> BadConfig:
    text = (
        f"{what} would let others in unguarded: {why}; {advice}, keep to loopback, or say --insecure "
        "([mesh] insecure = true) in a laboratory"
    )
    return BadConfig(text, field="endpoint", value=what, expected="loopback, or credentials and quic/ or tls/")
