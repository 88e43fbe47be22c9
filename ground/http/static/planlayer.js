// What is planned and what is kept clear of: ways that are flown or previewed, fences, no-fly areas, obstacles.

import { make } from "./dom.js";
import { toGlobal } from "./geo.js";
import { L } from "./vendor.js";

/** @typedef {import("./types.js").TrackPoint} TrackPoint @typedef {import("./types.js").Place} Place */

export class PlanLayer {
  /** @param {import("./store.js").Store} store @param {import("./map.js").FleetMap} view */
  constructor(store, view) {
    this.store = store;
    this.view = view;
    this.ways = L.layerGroup().addTo(view.map);
    this.shapes = L.layerGroup().addTo(view.map);
    /** @type {import("./types.js").Step[]} of a preview, one after another */
    this.previewed = [];
    this.drawnOf = "";
    this.drawnShapes = "";
  }

  /** Show what would be flown; an empty list shows nothing any more. @param {import("./types.js").Step[]} steps */
  preview(steps) {
    this.previewed = steps;
    this.drawnOf = "";
    const origin = this.store.origin;
    if (!this.previewed.length || !origin) return;
    const places = this.previewed.flatMap(({ tracks = {} }) => Object.values(tracks).flat().map((p) => toGlobal(origin, p[1], p[2])));
    this.view.follow(false);
    this.view.fit([...places, ...this.view.placesShown]);
  }

  draw() {
    const now = Date.now() / 1000;
    const state = JSON.stringify([[...this.store.plans.values()].map((plan) => [plan.goal, plan.start]), this.previewed.length, this.store.origin, Math.floor(now / 2)]);
    if (state !== this.drawnOf) {
      this.drawnOf = state;
      this.drawWays(now);
    }
    const shapes = JSON.stringify([[...this.store.obstacles.values()], this.store.origin, [...this.store.obstacles.values()].some((each) => each.what.shape === "ball") && Math.floor(now)]);
    if (shapes === this.drawnShapes) return;
    this.drawnShapes = shapes;
    this.shapes.clearLayers();
    if (this.store.origin) for (const each of this.store.obstacles.values()) this.shape(each, this.store.origin, now);
  }

  /** @param {number} now UTC seconds */
  drawWays(now) {
    this.ways.clearLayers();
    const origin = this.store.origin;
    if (!origin) return;
    const line = (/** @type {string} */ name, /** @type {TrackPoint[]} */ track, /** @type {object} */ style) => {
      const points = track.map((p) => toGlobal(origin, p[1], p[2])).map((place) => [place.lat, place.lon]);
      if (points.length < 2) return;
      L.polyline(points, { color: this.store.colourOf(name), interactive: false, ...style }).addTo(this.ways);
      L.circleMarker(points[points.length - 1], { color: this.store.colourOf(name), radius: 6, weight: 2, fill: false, interactive: false }).addTo(this.ways);
    };
    for (const plan of this.store.plans.values())
      for (const [name, track] of Object.entries(plan.tracks)) line(name, track.filter((p) => plan.start + p[0] >= now - 1), { weight: 2, dashArray: "8 6", opacity: 0.9 });
    for (const { tracks = {} } of this.previewed) for (const [name, track] of Object.entries(tracks)) line(name, track, { weight: 4, dashArray: "1 8", opacity: 0.9 });
  }

  /** @param {import("./types.js").Obstacle} obstacle @param {Place} origin @param {number} now UTC seconds */
  shape(obstacle, origin, now) {
    const what = obstacle.what;
    const at = (/** @type {number} */ north, /** @type {number} */ east) => {
      const place = toGlobal(origin, north, east);
      return [place.lat, place.lon];
    };
    const keepOut = { color: this.view.colour("--keepout"), weight: 2, fillOpacity: 0.16, interactive: false };
    const fence = { color: this.view.colour("--fence"), weight: 3, fill: false, dashArray: "12 6", interactive: false };
    const polygon = what.polygon ? what.polygon.map(([n, e]) => at(n, e)) : [];
    const [center, low, high] = [what.center || [0, 0], what.low || [0, 0], what.high || [0, 0]];
    const moved = (/** @type {number} */ i) => center[i] + (what.velocity ? what.velocity[i] * Math.min(now - obstacle.t, 30) : 0);
    const layer =
      what.shape === "geofence" ? L.polygon(polygon, fence)
      : what.shape === "no_fly" ? L.polygon(polygon, keepOut)
      : what.shape === "box" ? L.rectangle(L.latLngBounds([at(low[0], low[1]), at(high[0], high[1])]), keepOut)
      : L.circle(at(moved(0), moved(1)), { ...keepOut, radius: what.radius });
    layer.addTo(this.shapes).bindTooltip(make("span", "", obstacle.name), { permanent: true, direction: "center", className: "named" });
  }
}
