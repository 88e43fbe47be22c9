"""All that is shown: told what came (:class:`~ground.view.table.Batch`), it draws what has changed."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping

import msgspec
import rerun as rr

from ground.view import style, topics
from ground.view.canvas import NED, Canvas, Path
from ground.view.craft import Craft
from ground.view.frames import Datum
from ground.view.signals import Signals
from ground.view.table import Batch, Item
from mesh.graph import Graph
from zmav import wire
from zmav.doctor.ways import Link
from zmav.errors import ZmavError
from zmav.wire import Vector

logger = logging.getLogger(__name__)
CROWD = 12
"""vehicles above which names stand without modes"""
MOST = 1000
"""vehicles drawn"""
MESH_EVERY = 0.5
"""s between two drawings of links that follow their vehicles"""
LINES_A_STEP = 20
"""events logged in one step; the others wait for the next"""
LEVELS = {
    "emergency": rr.TextLogLevel.CRITICAL,
    "alert": rr.TextLogLevel.CRITICAL,
    "critical": rr.TextLogLevel.CRITICAL,
    "error": rr.TextLogLevel.ERROR,
    "warning": rr.TextLogLevel.WARN,
    "notice": rr.TextLogLevel.INFO,
    "info": rr.TextLogLevel.INFO,
    "debug": rr.TextLogLevel.DEBUG,
}


class Scene:
    """``several``: names are ``fleet/vehicle``, as there are several fleets; ``size``: of the models."""

    def __init__(self, canvas: Canvas, several: bool = False, size: float = 1.0) -> None:
        self._canvas, self._several, self._size = canvas, several, size
        self.datum = Datum()
        self.crafts: dict[tuple[str, ...], Craft] = {}
        self.bad = 0
        """values left out because they were not what they should be"""
        self._graph: Graph | None = None
        self._mesh_at = -math.inf
        self._signals = Signals()
        self._lines: list[tuple[str, str, str]] = []
        self._take: dict[str, Callable[[Item], None]] = {
            "state": self._on_state,
            "setpoint": self._on_setpoint,
            "event": self._on_event,
            "link": self._on_link,
            "fleet": self._on_topic,
            "graph": self._on_graph,
            "camera_frame": self._on_frame,
            "camera_detection": self._on_detection,
            "agent_out": self._on_signals,
        }

    @property
    def crowded(self) -> bool:
        """There are so many vehicles that less is told of each, and less often."""
        return len(self.crafts) > CROWD

    def apply(self, batch: Batch) -> None:
        """Take what came. What is not what it should be is counted and left out."""
        for item in batch.items:
            try:
                self._take[item.kind](item)
            except ZmavError:
                self.bad += 1
            except Exception:  # somebody's payload must not end the picture of everything else
                self.bad += 1
                logger.debug("%s of %s was not understood", item.kind, item.place, exc_info=True)
        if batch.lost:
            self.say("viewer", "warning", f"{batch.lost} events came faster than they could be shown")

    def paint(self, now: float, t: float) -> None:
        """Put on the canvas what has changed; ``now`` is monotonic, ``t`` UTC seconds."""
        for craft in self.crafts.values():
            craft.paint(self._canvas, self.datum, now, t, self.crowded)
        if self._graph is not None and now - self._mesh_at >= MESH_EVERY:
            self._mesh_at = now
            places = {craft.label: craft.position for craft in self.crafts.values() if craft.position is not None}
            _paint_mesh(self._canvas, self._graph, places)
        said, self._lines = self._lines[:LINES_A_STEP], self._lines[LINES_A_STEP:]
        for who, severity, text in said:
            level = LEVELS.get(severity, rr.TextLogLevel.INFO)
            self._canvas.line(("events", who), rr.TextLog(f"{who}: {text}", level=level))

    def say(self, who: str, severity: str, text: str) -> None:
        """A line in the log of events."""
        if len(self._lines) < 2000:
            self._lines.append((who, severity, text[:500]))

    # What comes, by its kind.

    def _craft(self, place: tuple[str, ...]) -> Craft:
        found = self.crafts.get(place[:2])
        if found is None:
            if len(self.crafts) >= MOST:
                raise ZmavError(f"more than {MOST} vehicles are not drawn")
            fleet, name = place[:2]
            found = self.crafts[fleet, name] = Craft(fleet, name, self._label(place), self._size)
        return found

    def _label(self, place: tuple[str, ...]) -> str:
        return f"{place[0]}/{place[1]}" if self._several else place[1]

    def _on_state(self, item: Item) -> None:
        state = wire.decode(item.payload, wire.VehicleState, "state")
        craft = self._craft(item.place)
        if self.datum.learn(state):
            self._replace(craft.label)
        craft.on_state(state, item.t, item.mono, self.datum)
        if craft.position is None and state.position is not None:
            self._once(craft, "its position cannot be drawn: it is no number, or more than 100 km from the origin")

    def _once(self, craft: Craft, text: str) -> None:
        if not craft.complained:
            craft.complained = True
            self.say(craft.label, "warning", text)

    def _on_setpoint(self, item: Item) -> None:
        setpoint = wire.decode(item.payload, wire.Setpoint, "setpoint")
        self._craft(item.place).setpoints.on_setpoint(item.place[2], setpoint, item.mono)

    def _on_event(self, item: Item) -> None:
        event = wire.decode(item.payload, wire.Event, "event")
        self.say(self._craft(item.place).label, event.severity, f"{event.kind}: {event.text}")

    def _on_link(self, item: Item) -> None:
        if item.place[2] != "autopilot":
            return  # links between routers are drawn from the graph, which knows both ends
        quality = wire.decode_link(item.payload)
        if isinstance(quality, wire.LinkQuality):
            craft = self._craft(item.place)
            craft.plot(self._canvas, "loss", 100.0 * quality.loss, "autopilot", dim=True)
            if quality.rtt is not None:
                craft.plot(self._canvas, "rtt", 1e3 * quality.rtt, "autopilot", dim=True)

    def _on_graph(self, item: Item) -> None:
        self._graph = msgspec.json.decode(item.payload, type=Graph)
        self._mesh_at = -math.inf
        by_label = {craft.label: craft for craft in self.crafts.values()}
        for name, way in self._graph.ways.items():
            if (craft := by_label.get(name)) is not None:
                if way.rtt is not None:
                    craft.plot(self._canvas, "rtt", 1e3 * way.rtt)
                if (arrives := way.delivery(back=True)) is not None:
                    craft.plot(self._canvas, "loss", 100.0 * (1.0 - arrives))

    def _on_topic(self, item: Item) -> None:
        topic = item.place[1]
        if topic == "origin":
            if self.datum.declare(wire.decode(item.payload, wire.Origin, "origin")):
                self._replace("@fleet/origin")
            return
        if unknown := topics.paint(self._canvas, topic, item.payload):
            self.say("fleet", "info", unknown)

    def _on_signals(self, item: Item) -> None:
        self.bad += self._signals.take(self._canvas, item.place, self._label(item.place), item.payload)

    def _on_frame(self, item: Item) -> None:
        if not _paint_frame(self._canvas, self._craft(item.place).label, item.place[2], item.payload):
            self.bad += 1

    def _on_detection(self, item: Item) -> None:
        seen = wire.decode(item.payload, wire.Detections, "detection")
        _paint_detection(self._canvas, self._craft(item.place).label, item.place[2], seen)

    # The origin.

    def _replace(self, by: str) -> None:
        """The origin has changed: say so, and draw everything about the new one."""
        origin, rank = self.datum.origin, self.datum.rank
        assert origin is not None
        place = f"{origin.lat_deg:.6f} {origin.lon_deg:.6f}, {origin.alt_amsl:.1f} m AMSL"
        if rank == "provisional":
            self.say("viewer", "warning", f"no fleet origin is known: drawn about the ground below {by} ({place})")
        else:
            self.say("viewer", "info", f"the fleet's origin, {rank} by {by}: {place}")
        for craft in self.crafts.values():
            craft.forget_trail(self._canvas)
            craft.place(self.datum)


BEGIN, END = b"\xff\xd8\xff", b"\xff\xd9"
MOST_BOXES = 200
"""boxes drawn into one picture"""


def _paint_frame(canvas: Canvas, label: str, camera: str, jpeg: bytes) -> bool:
    """Show a picture; False for what is no whole JPEG."""
    if not jpeg.startswith(BEGIN) or END not in jpeg[-64:]:
        return False
    canvas.put(_camera_path(label, camera), rr.EncodedImage(contents=jpeg, media_type="image/jpeg"))
    return True


def _paint_detection(canvas: Canvas, label: str, camera: str, seen: wire.Detections) -> None:
    """Box the symbols that were found; none of them clears the picture."""
    found = seen.found[:MOST_BOXES]
    boxes = rr.Boxes2D(
        mins=[(each.u - each.scale_px / 2.0, each.v - each.scale_px / 2.0) for each in found],
        sizes=[(each.scale_px, each.scale_px) for each in found],
        labels=[each.symbol for each in found],
        colors=style.GRADES["good"],
        radii=1.0,
    )
    canvas.put((*_camera_path(label, camera), "detection"), boxes if found else None)


def _camera_path(label: str, camera: str) -> Path:
    return ("camera", label, camera)


PATH = (*NED, "mesh")
FIGURES = (*PATH, "figures")
"""of the links that are not good: those of all would stand over each other, and over the names of vehicles"""
LABELLED = 12
"""links at most whose figures stand beside them"""


def _paint_mesh(canvas: Canvas, graph: Graph, places: Mapping[str, Vector]) -> None:
    """Draw the links between hosts whose places are known; the others (a ground station's) stand in a row at the
    origin, to the south.
    """
    ends = {name for link in graph.links for name in (link.a, link.b)}
    stations = sorted(name for name in ends if name not in places and _role(graph, name) != "vehicle")
    where = {**places, **{name: (-4.0 * (i + 1), 0.0, 0.0) for i, name in enumerate(stations)}}
    _paint_stations(canvas, {name: where[name] for name in stations})
    drawn = [link for link in graph.links if link.a in where and link.b in where]
    strips = rr.LineStrips3D(
        [[where[link.a], where[link.b]] for link in drawn],
        colors=[style.GRADES.get(link.grade, style.GREY) for link in drawn],
        radii=[style.points(style.WIDTHS.get(link.grade, 1.0)) for link in drawn],
    )
    canvas.put(PATH, strips if drawn else None)
    worse = [link for link in drawn if link.grade != "good"]
    figures = rr.Points3D(
        [[(a + b) / 2.0 for a, b in zip(where[link.a], where[link.b], strict=True)] for link in worse],
        colors=[style.GRADES.get(link.grade, style.GREY) for link in worse],
        radii=style.points(0.5),
        labels=[_link_words(link) for link in worse],
        show_labels=len(worse) <= LABELLED,
    )
    canvas.put(FIGURES, figures if worse else None)


def _role(graph: Graph, name: str) -> str | None:
    node = graph.nodes.get(name)
    return node.role if node else None


def _paint_stations(canvas: Canvas, stations: Mapping[str, Vector]) -> None:
    points = rr.Points3D(
        list(stations.values()), colors=style.WHITE, radii=style.points(5.0), labels=list(stations), show_labels=True
    )
    canvas.put((*PATH, "stations"), points if stations else None)


def _link_words(link: Link) -> str:
    """A link in words: ``12 ms 3 % lost``."""
    if link.grade == "down":
        return "down"
    parts = [] if link.rtt is None else [f"{1e3 * link.rtt:.0f} ms" if link.rtt >= 0.001 else "<1 ms"]
    if (loss := link.worst_loss) is not None and loss >= 0.005:
        parts.append(f"{loss:.0%} lost")
    return " ".join(parts) or link.grade
