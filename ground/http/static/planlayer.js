"use strict";
// What is planned and what is kept clear of: ways that are flown or previewed, fences, no-fly areas, obstacles.

class PlanLayer {
  /** @param {Store} store @param {FleetMap} view */
  constructor(store, view) {
    this.store = store;
    this.view = view;
    this.ways = L.layerGroup().addTo(view.map);
    this.shapes = L.layerGroup().addTo(view.map);
    /** @type {Record<string, number[][]>[]} tracks of a preview, one after another */
    this.previewed = [];
    this.drawnOf = "";
    this.drawnShapes = "";
  }

  /** Show what would be flown; an empty list shows nothing any more. @param {any[]} steps */
  preview(steps) {
    this.previewed = steps.map((step) => step.tracks || {});
    this.drawnOf = "";
    if (!this.previewed.length || !this.store.origin) return;
    const places = this.previewed.flatMap((tracks) => Object.values(tracks).flat().map((p) => toGlobal(this.store.origin, p[1], p[2])));
    this.view.follow(false);
    this.view.fit([...places, ...this.view.shown.map((vehicle) => vehicle.place)]);
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
    if (this.store.origin) for (const each of this.store.obstacles.values()) this.shape(each, now);
  }

  drawWays(now) {
    this.ways.clearLayers();
    if (!this.store.origin) return;
    const colour = (name) => (this.store.all.find((vehicle) => vehicle.name === name) || { colour: "gray" }).colour;
    const line = (name, track, style) => {
      const points = track.map((p) => toGlobal(this.store.origin, p[1], p[2])).map((place) => [place.lat, place.lon]);
      if (points.length < 2) return;
      L.polyline(points, { color: colour(name), interactive: false, ...style }).addTo(this.ways);
      L.circleMarker(points[points.length - 1], { color: colour(name), radius: 6, weight: 2, fill: false, interactive: false }).addTo(this.ways);
    };
    for (const plan of this.store.plans.values())
      for (const [name, track] of Object.entries(plan.tracks)) line(name, track.filter((p) => plan.start + p[0] >= now - 1), { weight: 2, dashArray: "8 6", opacity: 0.9 });
    for (const tracks of this.previewed) for (const [name, track] of Object.entries(tracks)) line(name, track, { weight: 4, dashArray: "1 8", opacity: 0.9 });
  }

  /** @param {any} obstacle see zmav/wire/swarm.py @param {number} now UTC seconds */
  shape(obstacle, now) {
    const what = obstacle.what;
    /** @returns {[number, number]} */
    const at = (north, east) => {
      const place = toGlobal(this.store.origin, north, east);
      return [place.lat, place.lon];
    };
    const keepOut = { color: this.view.colour("--keepout"), weight: 2, fillOpacity: 0.16, interactive: false };
    const fence = { color: this.view.colour("--fence"), weight: 3, fill: false, dashArray: "12 6", interactive: false };
    const polygon = what.polygon ? what.polygon.map(([n, e]) => at(n, e)) : [];
    const moved = (i) => what.center[i] + (what.velocity ? what.velocity[i] * Math.min(now - obstacle.t, 30) : 0);
    const layer =
      what.shape === "geofence" ? L.polygon(polygon, fence)
      : what.shape === "no_fly" ? L.polygon(polygon, keepOut)
      : what.shape === "box" ? L.rectangle(L.latLngBounds([at(what.low[0], what.low[1]), at(what.high[0], what.high[1])]), keepOut)
      : L.circle(at(moved(0), moved(1)), { ...keepOut, radius: what.radius });
    layer.addTo(this.shapes).bindTooltip(make("span", "", obstacle.name), { permanent: true, direction: "center", className: "named" });
  }
}
