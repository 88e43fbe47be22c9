"""Zenoh endpoints as routers use them: ``quic/10.77.0.1:7447?mixed_rel=1#bind=10.77.0.2:0``."""

from __future__ import annotations


def between(address: str, port: int, guarded: bool) -> str:
    """How routers speak to each other: QUIC, with TLS where there are credentials; see docs/mesh.md for why."""
    place = f"{bracketed(address)}:{port}"
    return f"quic/{place}?mixed_rel=1" if guarded else f"udp/{place}?rel=1;mixed_rel=1"


def bound(endpoint: str, address: str) -> str:
    """Called from ``address``: a link from no address in particular is on every interface, for Zenoh's rules."""
    return f"{endpoint}#bind={bracketed(address)}:0"


def place(endpoint: str) -> str:
    """Address and port, without protocol and settings."""
    return endpoint.partition("/")[2].partition("?")[0].partition("#")[0]


def host_port(endpoint: str) -> tuple[str, str]:
    """Host, without brackets, and port; the port is empty where there is none."""
    host, colon, port = place(endpoint).rpartition(":")
    return (host if colon else port).strip("[]"), port if colon else ""


def bracketed(address: str) -> str:
    """An address as it stands before a port."""
    return f"[{address}]" if ":" in address else address
