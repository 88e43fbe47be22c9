"""What ``link/{name}`` says: how well a vehicle's autopilot is heard, and how well a router hears its neighbours.

Both are told apart by ``kind``; :func:`decode_link` reads either.
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from zmav.errors import BadInput
from zmav.wire.base import Told, decode

LinkState = Literal["up", "silent", "down"]
Share = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]
Amount = Annotated[float, msgspec.Meta(ge=0.0)]


class LinkQuality(Told, kw_only=True, tag_field="kind", tag="autopilot"):
    """The link to a vehicle's autopilot, with every counter of its splitter."""

    t: float
    name: str
    url: str
    state: str
    age: float | None
    """seconds since anything was heard; None: never"""
    rx_rate: float
    """frames a second over the last interval"""
    rx_bytes_rate: float
    loss: float
    """share of the vehicle's own frames lost over the last interval, 0 to 1, from their sequence numbers"""
    rtt: float | None = None
    """seconds, by TIMESYNC"""
    signal: float | None = None
    rx_frames: int = 0
    rx_bytes: int = 0
    lost: int = 0
    """of the vehicle's own frames"""
    bad_crc: int = 0
    bad_length: int = 0
    bad_flags: int = 0
    garbage: int = 0
    unknown: int = 0
    tx_frames: int = 0
    tx_dropped: int = 0
    tx_refused: int = 0
    """frames put on ``mav/tx`` that were not fit to be sent"""
    bad_signature: int = 0
    """frames refused for a wrong or an old signature, where the link is signed"""
    unsigned: int = 0
    """frames refused for having none"""
    rx_dropped: int = 0
    """datagrams that the kernel threw away because nobody took them in time (UDP on Linux)"""
    opens: int = 0
    last_error: str | None = None


class NeighbourQuality(Told, kw_only=True, tag_field="kind", tag="neighbour", omit_defaults=True):
    """The link between two routers, as the one that publishes it sees it: ``out`` is from it to ``name``, ``in`` back.

    What is not known is left out. Loss is of best-effort messages, which no transport repairs (over TCP and TLS, which
    know no other messages, a bad radio shows in the round trip).
    """

    t: float
    name: str
    """the neighbour's; its router's id where it does not say its name"""
    router: str
    """id of the router that speaks, hexadecimal"""
    peer: str
    """id of the neighbour's router"""
    url: str
    """Zenoh's locator of the neighbour's end"""
    state: LinkState
    """silent: linked, and no probe comes; down: the link went away within the last minute"""
    age: Amount | None = None
    """s since a probe of the neighbour was heard"""
    rtt: Amount | None = None
    """s, median of the last probes"""
    rtt_min: Amount | None = None
    loss_in: Share | None = None
    """0 to 1"""
    loss_out: Share | None = None
    signal: float | None = None
    """dBm at our end"""
    cost: Annotated[int, msgspec.Meta(ge=1)] | None = None
    """:func:`mesh.quality.publisher.cost`: about 10 µs a kilobyte, one way"""
    interface: str | None = None
    since: float | None = None
    """UTC seconds since when the state is what it is"""


def decode_link(data: bytes, what: str = "link") -> LinkQuality | NeighbourQuality:
    """Raises :class:`BadInput` for what is neither."""
    try:
        kind = msgspec.json.decode(data, type=_Kind).kind
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as e:
        raise BadInput(f"{what}: no link's quality: {e}", field=what, expected="a JSON object with its kind") from None
    if kind == "neighbour":
        return decode(data, NeighbourQuality, what)
    return decode(data, LinkQuality, what)


class _Kind(msgspec.Struct):
    kind: str = "autopilot"
