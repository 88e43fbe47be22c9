"""Leaflet, which the page has, and MapLibre GL beside each other: fifty marks that move five times a second.

    npm install --prefix /tmp/gl maplibre-gl@5
    python tests/bench/page_maps.py /tmp/gl/node_modules/maplibre-gl/dist [--rounds 5]

In Chromium without a graphics card (SwiftShader draws WebGL), both in one run, round by round: frames a second, the
main thread's share of the time (its waits count), and the share of a core, and ms a frame, of all of the browser's
processes; while the map stands, and while it is dragged along. Medians. Both draw the world's outline that ships with
the page, and the same element for each mark and its name.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import functools
import http.server
import json
import os
import statistics
import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.ground.http.browser import Tab, browser

VENDOR = Path(__file__).resolve().parents[2] / "ground" / "http" / "static" / "vendor"
FLAGS = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")
SECONDS = 8.0
HEAD = """<!doctype html><meta charset="utf-8"><link rel="icon" href="data:,"><link rel="stylesheet" href="CSS">
<body style="margin:0"><div id="map" style="width:1000px;height:800px"></div>
<script src="LIBRARY"></script><script src="common.js"></script><script>"""
COMMON = """
const COUNT = 50, LAT = -35.3, LON = 149.1;
const place = (i, t) => [
  LAT + 0.0004 * Math.floor(i / 10) + 0.0002 * Math.sin(t / 10 + i),
  LON + 0.0005 * (i % 10) + 0.0002 * Math.cos(t / 10 + i),
];
const mark = (i) => `<svg viewBox="-10 -10 20 20" width="28" height="28">
  <circle r="8" fill="none" stroke="#15c" stroke-width="2"/>
  <path d="M0-7 5 6 0 3-5 6z" fill="#15c" transform="rotate(${7 * i})"/></svg>
  <b style="font:11px sans-serif">quad${i + 1}</b>`;
const numbers = [...Array(COUNT).keys()];
window.frames_drawn = 0;
const count = () => { window.frames_drawn += 1; requestAnimationFrame(count); };
requestAnimationFrame(count);
const each = (move) => setInterval(() => {
  const t = performance.now() / 1000;
  for (const i of numbers) move(i, place(i, t));
}, 200);
window.drag = () => setInterval(() => pan(40 * Math.sign(Math.sin(performance.now() / 500))), 200);
"""
LEAFLET = (
    HEAD.replace("CSS", "leaflet.css").replace("LIBRARY", "leaflet.js")
    + """
const map = L.map("map", {zoomControl: false, attributionControl: false}).setView([LAT + 0.0008, LON + 0.0022], 17);
fetch("land.json").then((reply) => reply.json()).then((land) => {
  L.geoJSON(land, {style: {color: "#888", weight: 1}}).addTo(map);
  window.ready = true;
});
const icon = (i) => L.divIcon({className: "", html: mark(i), iconSize: [28, 42]});
const marks = numbers.map((i) => L.marker(place(i, 0), {icon: icon(i)}).addTo(map));
each((i, at) => marks[i].setLatLng(at));
const pan = (x) => map.panBy([x, 0], {animate: true, duration: 0.2});
</script>"""
)
MAPLIBRE = (
    HEAD.replace("CSS", "gl/maplibre-gl.css").replace("LIBRARY", "gl/maplibre-gl.js")
    + """
const style = {
  version: 8,
  sources: {land: {type: "geojson", data: "land.json"}},
  layers: [{id: "land", type: "line", source: "land", paint: {"line-color": "#888"}}],
};
const center = [LON + 0.0022, LAT + 0.0008];
const map = new maplibregl.Map({container: "map", attributionControl: false, center, zoom: 16, style});
map.on("load", () => { window.ready = true; });
const marks = numbers.map((i) => {
  const element = document.createElement("div");
  element.innerHTML = mark(i);
  return new maplibregl.Marker({element}).setLngLat(place(i, 0).reverse()).addTo(map);
});
each((i, [lat, lon]) => marks[i].setLngLat([lon, lat]));
const pan = (x) => map.panBy([x, 0], {duration: 200});
</script>"""
)


@contextlib.contextmanager
def served(maplibre: Path) -> Iterator[str]:
    """Both pages and what they are made of."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "gl").symlink_to(maplibre.resolve())
        for vendored in ("leaflet.js", "leaflet.css"):
            (folder / vendored).symlink_to(VENDOR / vendored)
        (folder / "land.json").write_text(json.dumps(outline()))
        for page, text in (("common.js", COMMON), ("leaflet.html", LEAFLET), ("maplibre.html", MAPLIBRE)):
            (folder / page).write_text(text)
        handler = functools.partial(Quiet, directory=name)
        with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
            threading.Thread(target=server.serve_forever, daemon=True).start()
            yield f"http://127.0.0.1:{server.server_port}"
            server.shutdown()


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_: Any) -> None:
        """Nothing."""


def outline() -> dict[str, Any]:
    """The vendored TopoJSON's arcs as one MultiLineString."""
    topology = json.loads((VENDOR / "land-110m.json").read_text())
    (sx, sy), (tx, ty) = topology["transform"]["scale"], topology["transform"]["translate"]
    lines = []
    for arc in topology["arcs"]:
        x = y = 0
        line = []
        for dx, dy in arc:
            x, y = x + dx, y + dy
            line.append([x * sx + tx, y * sy + ty])
        lines.append(line)
    return {"type": "Feature", "properties": {}, "geometry": {"type": "MultiLineString", "coordinates": lines}}


def spent(group: int) -> float:
    """s of processor that the processes of a group have had."""
    ticks = 0
    for entry in Path("/proc").iterdir():
        with contextlib.suppress(OSError, ValueError, IndexError):
            fields = (entry / "stat").read_text().rpartition(")")[2].split()
            if entry.name.isdigit() and int(fields[2]) == group:
                ticks += int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK")


async def measured(tab: Tab) -> dict[str, float]:
    async def look() -> tuple[float, float, float, float]:
        metrics = {m["name"]: m["value"] for m in (await tab.call("Performance.getMetrics"))["metrics"]}
        return metrics["Timestamp"], metrics["TaskDuration"], await tab.run("window.frames_drawn"), spent(tab.group)

    first = await look()
    await asyncio.sleep(SECONDS)
    seconds, busy, frames, all_of_it = (b - a for a, b in zip(first, await look(), strict=True))
    return {"frames": frames / seconds, "main": busy / seconds, "all": all_of_it / seconds}


async def run(maplibre: Path, rounds: int) -> dict[str, dict[str, float]]:
    found: dict[str, list[dict[str, float]]] = {}
    with served(maplibre) as address:
        for _ in range(rounds):
            for page in ("leaflet", "maplibre"):
                async with browser(*FLAGS) as tab:
                    await tab.open(f"{address}/{page}.html")
                    await tab.size(1000, 800)
                    await tab.call("Performance.enable")
                    await tab.until("window.ready")
                    await asyncio.sleep(2.0)
                    found.setdefault(f"{page}, at rest", []).append(await measured(tab))
                    await tab.run("window.drag() && true")
                    found.setdefault(f"{page}, dragged", []).append(await measured(tab))
    return {
        name: {key: statistics.median(each[key] for each in rows) for key in rows[0]} for name, rows in found.items()
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("maplibre", type=Path, help="the folder dist of maplibre-gl")
    parser.add_argument("--rounds", type=int, default=5)
    given = parser.parse_args()
    for name, row in sorted(asyncio.run(run(given.maplibre, given.rounds)).items()):
        each = 1e3 * row["all"] / row["frames"]
        shares = f"main {row['main']:6.1%}  all processes {row['all']:6.1%}, {each:4.1f} ms a frame"
        print(f"{name:<20} {row['frames']:5.1f} frames/s  {shares}")


if __name__ == "__main__":
    main()
