"""``/metrics``: the fleet and the gateway itself for Prometheus.

What a scrape shows is there already, but for the links: of these the vehicles are asked when somebody scrapes. No
metric has a label whose values a stranger could multiply, but for the names of vehicles and links, of which there is a
bound.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable, Iterable
from typing import Any, Literal

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route

from ground.http.gateway import Gateway
from zmav import keys, wire
from zmav.client import Answer
from zmav.errors import BadInput, BadKey
from zmav.vehicle import Vehicle

LINKS_EVERY = 1.0
"""s at least between two questions for links, however many scrape"""
PATIENCE = 1.0
"""s for vehicles to say how their links are: a scrape waits no longer for one that is gone"""
MOST_LINKS = 2000
MOST_VEHICLES = 1000
CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
Kind = Literal["gauge", "counter"]
Row = tuple[str, Kind, str, Callable[[Any], float | None]]
"""a metric's name without its beginning, its kind, what it is, and how it is read; None: it is not known"""

STATE: tuple[Row, ...] = (
    ("autopilot_connected", "gauge", "The autopilot's heartbeat is fresh.", lambda s: s.connected),
    ("armed", "gauge", "It is armed.", lambda s: s.armed),
    ("ready", "gauge", "It is ready to be armed.", lambda s: s.ready),
    ("landed", "gauge", "It is on the ground.", lambda s: s.landed),
    ("clash", "gauge", "Somebody else claims its name or system id.", lambda s: s.clash is not None),
    ("pilot_has_it", "gauge", "The pilot's switch keeps every agent off.", lambda s: s.pilot is not None),
    ("lease_held", "gauge", "Somebody holds the lease.", lambda s: s.lease is not None),
    ("battery_volts", "gauge", "Battery voltage.", lambda s: s.battery.voltage if s.battery else None),
    ("battery_amperes", "gauge", "Battery current.", lambda s: s.battery.current if s.battery else None),
    ("battery_remaining_ratio", "gauge", "Charge left, 0 to 1.", lambda s: s.battery.remaining if s.battery else None),
    (
        "battery_left_seconds",
        "gauge",
        "Time left, estimated.",
        lambda s: s.battery.time_left if s.battery else None,
    ),
    ("latitude_degrees", "gauge", "WGS84 latitude.", lambda s: s.position.lat_deg if s.position else None),
    ("longitude_degrees", "gauge", "WGS84 longitude.", lambda s: s.position.lon_deg if s.position else None),
    (
        "altitude_amsl_meters",
        "gauge",
        "Altitude above mean sea level.",
        lambda s: s.position.alt_amsl if s.position else None,
    ),
    ("altitude_relative_meters", "gauge", "Altitude above home.", lambda s: s.position.alt_rel if s.position else None),
    ("gps_satellites", "gauge", "Satellites in use.", lambda s: s.gps.satellites if s.gps else None),
    ("gps_accuracy_meters", "gauge", "Horizontal, by its own estimate.", lambda s: s.gps.h_acc if s.gps else None),
    ("gps_hdop", "gauge", "Horizontal dilution of precision.", lambda s: s.gps.hdop if s.gps else None),
    ("link_loss_ratio", "gauge", "Share of the autopilot's frames lost, 0 to 1.", lambda s: s.link_loss),
)
"""of a vehicle's last state"""
AUTOPILOT_LINK: tuple[Row, ...] = (
    ("link_up", "gauge", "The link to the autopilot is up.", lambda q: q.state == "up"),
    ("link_rx_frames_per_second", "gauge", "Frames a second from the autopilot.", lambda q: q.rx_rate),
    ("link_rx_bytes_per_second", "gauge", "Bytes a second from the autopilot.", lambda q: q.rx_bytes_rate),
    ("link_rtt_seconds", "gauge", "Round trip to the autopilot.", lambda q: q.rtt),
    ("link_rx_frames_total", "counter", "Frames from the autopilot.", lambda q: q.rx_frames),
    ("link_lost_frames_total", "counter", "Frames of the autopilot's own that were lost.", lambda q: q.lost),
    ("link_bad_frames_total", "counter", "Frames with a wrong checksum.", lambda q: q.bad_crc),
    ("link_tx_frames_total", "counter", "Frames to the autopilot.", lambda q: q.tx_frames),
    ("link_tx_refused_total", "counter", "Frames put on mav/tx that were not fit to be sent.", lambda q: q.tx_refused),
)
NEIGHBOUR: tuple[Row, ...] = (
    ("neighbour_up", "gauge", "The link to the neighbour's router is up.", lambda q: q.state == "up"),
    ("neighbour_rtt_seconds", "gauge", "Round trip to the neighbour.", lambda q: q.rtt),
    ("neighbour_loss_in_ratio", "gauge", "Share lost from the neighbour, 0 to 1.", lambda q: q.loss_in),
    ("neighbour_loss_out_ratio", "gauge", "Share lost to the neighbour, 0 to 1.", lambda q: q.loss_out),
    ("neighbour_signal_dbm", "gauge", "Signal at our end.", lambda q: q.signal),
)
GATEWAY: tuple[Row, ...] = (
    ("frames_total", "counter", "Frames heard by the gateway.", lambda g: g.frames),
    ("sent_total", "counter", "Frames put to vehicles.", lambda g: g.sent),
    ("start_time_seconds", "gauge", "When the gateway began (UTC seconds).", lambda g: g.started),
)
FIGURES: dict[str, tuple[Kind, str]] = {
    "websockets": ("gauge", "WebSockets on /ws."),
    "subscriptions": ("gauge", "Their subscriptions."),
    "dropped": ("counter", "Samples that they lost for want of room."),
    "cut": ("counter", "WebSockets cut off because they did not read."),
    "streams": ("gauge", "Streams of setpoints that the gateway holds leases for."),
    "video_viewers": ("gauge", "Browsers that watch cameras' video."),
    "video_units": ("counter", "Encoded pictures of video sent, of all viewers."),
    "camera_readers": ("gauge", "Readers of cameras' pictures."),
    "pictures": ("counter", "Pictures sent to them."),
    "pictures_left_out": ("counter", "Pictures that came while their reader still took another."),
}
"""what faces count of themselves in :attr:`Gateway.figures`"""


class Exposition:
    """Families in the order in which they were first added, each sample of one beside its others.

    https://prometheus.io/docs/instrumenting/exposition_formats/ (text format 0.0.4)
    """

    def __init__(self) -> None:
        self._heads: dict[str, str] = {}
        self._lines: dict[str, list[str]] = {}

    def add(self, name: str, kind: Kind, doc: str, value: float | None, /, **labels: str | None) -> None:
        """One sample; None is no sample. A label that is None is left empty."""
        if name not in self._heads:
            self._heads[name] = f"# HELP {name} {_escape(doc)}\n# TYPE {name} {kind}\n"
            self._lines[name] = []
        if value is None:
            return
        inside = ",".join(f'{label}="{_quoted(text or "")}"' for label, text in labels.items())
        self._lines[name].append(f"{name}{{{inside}}} {_number(value)}\n" if inside else f"{name} {_number(value)}\n")

    def add_rows(self, beginning: str, rows: Iterable[Row], what: object, /, **labels: str | None) -> None:
        """A sample of each row of a table, as it is read from ``what``."""
        for name, kind, doc, read in rows:
            self.add(beginning + name, kind, doc, read(what), **labels)

    def text(self) -> str:
        return "".join(head + "".join(self._lines[name]) for name, head in self._heads.items())


def _number(value: float) -> str:
    if math.isfinite(value):
        return str(int(value)) if value == int(value) and abs(value) < 1e15 else repr(float(value))
    return "NaN" if math.isnan(value) else ("+Inf" if value > 0 else "-Inf")


def _escape(text: str) -> str:
    return text.replace("\\", "\\\\").replace("\n", "\\n")


def _quoted(text: str) -> str:
    return _escape(text).replace('"', '\\"')


Quality = tuple[str, str, "wire.LinkQuality | wire.NeighbourQuality"]
"""fleet, vehicle, and how a link of its is"""


def routes(gateway: Gateway) -> list[BaseRoute]:
    links: list[Quality] = []
    asked, asking = -math.inf, asyncio.Lock()

    async def metrics(request: Request) -> Response:
        """The fleet and the gateway in Prometheus' text format."""
        nonlocal links, asked
        page = Exposition()
        for vehicle in gateway.client.fleet()[:MOST_VEHICLES]:
            _of_vehicle(page, vehicle)
        async with asking:
            if time.monotonic() - asked >= LINKS_EVERY:
                key = keys.LINK.key(gateway.client.fleet_name, "*", link="*")
                links = _qualities(await gateway.client.ask(key, timeout=PATIENCE, channel=keys.LINK))
                asked = time.monotonic()
        for fleet, name, quality in links:
            _of_link(page, fleet, name, quality)
        _of_gateway(page, gateway)
        return Response(page.text(), headers={"Content-Type": CONTENT_TYPE, "Cache-Control": "no-store"})

    return [Route("/metrics", metrics, methods=["GET"])]


def _of_vehicle(page: Exposition, vehicle: Vehicle) -> None:
    where = {"fleet": vehicle.fleet, "vehicle": vehicle.name}
    page.add("zmav_vehicle_up", "gauge", "Its token is there or its state is fresh.", vehicle.present, **where)
    page.add("zmav_vehicle_state_age_seconds", "gauge", "Seconds since its state was heard.", vehicle.age, **where)
    state = vehicle.last_state
    if state is None:
        return
    about = {"kind": state.kind, "autopilot": state.autopilot, "firmware": state.firmware}
    sysid = str(state.sysid or "")
    page.add("zmav_vehicle_info", "gauge", "What it is; the value is 1.", 1, **where, sysid=sysid, **about)
    page.add("zmav_vehicle_mode", "gauge", "The flight mode it is in; the value is 1.", 1, **where, mode=state.mode)
    if state.gps is not None:
        page.add("zmav_vehicle_gps_fix", "gauge", "The fix it has; the value is 1.", 1, **where, fix=state.gps.fix)
    page.add_rows("zmav_vehicle_", STATE, state, **where)
    for reason, count in list(state.setpoints.items())[:20]:
        doc = "Setpoints by what became of them."
        page.add("zmav_vehicle_setpoints_total", "counter", doc, count, **where, outcome=reason)


def _of_link(page: Exposition, fleet: str, name: str, quality: wire.LinkQuality | wire.NeighbourQuality) -> None:
    if isinstance(quality, wire.NeighbourQuality):
        page.add_rows("zmav_", NEIGHBOUR, quality, fleet=fleet, vehicle=name, neighbour=quality.name)
    else:
        page.add_rows("zmav_", AUTOPILOT_LINK, quality, fleet=fleet, vehicle=name, link=quality.name)


def _of_gateway(page: Exposition, gateway: Gateway) -> None:
    page.add_rows("zmav_http_", GATEWAY, gateway)
    for name, read in gateway.figures.items():
        kind, doc = FIGURES[name]
        page.add(f"zmav_http_{name}{'_total' if kind == 'counter' else ''}", kind, doc, read())


def _qualities(answers: list[Any]) -> list[Quality]:
    found = []
    for each in answers[:MOST_LINKS]:
        if isinstance(each, Answer):
            with contextlib.suppress(BadInput, BadKey):
                parts = keys.match(each.key)[1]
                found.append((parts["fleet"], parts["vehicle"], wire.decode_link(each.payload, each.key)))
    return found
