// The slider below the map: where everybody is at a time of what is planned, as hollow marks.

import { byId, make, say } from "./dom.js";
import { toGlobal } from "./geo.js";
import { lengthOf, ofPlans, ofPreview, placesAt } from "./timeline.js";
import { L } from "./vendor.js";
import { fixed, span, t } from "./words.js";

/** @typedef {{name: string, colour: string, place: import("./types.js").Place, height: number}} Ghost */

export class Scrubber {
  /** @param {import("./store.js").Store} store @param {import("./map.js").FleetMap} view @param {import("./planlayer.js").PlanLayer} plans */
  constructor(store, view, plans) {
    this.store = store;
    this.plans = plans;
    this.layer = L.layerGroup().addTo(view.map);
    this.slider = byId("scrub-time");
    /** Moved by a person; else it goes with the time of what is flown. */
    this.held = false;
    /** @type {Ghost[]} */
    this.ghosts = [];
    this.shown = "";
    this.slider.addEventListener("input", () => {
      this.held = true;
      this.draw();
    });
    byId("scrub-now").addEventListener("click", () => {
      this.held = false;
      this.draw();
    });
  }

  draw() {
    const { parts, now } = this.timeline();
    const length = lengthOf(parts);
    byId("scrub").hidden = length === 0;
    byId("scrub-now").hidden = !this.held;
    if (length === 0) this.held = false;
    this.slider.max = length.toFixed(1);
    if (!this.held) this.slider.value = String(Math.min(now, length));
    const at = Number(this.slider.value);
    const words = t("scrub.words", { at: span(at), length: span(length) });
    say(byId("scrub-words"), words);
    if (length) this.slider.setAttribute("aria-valuetext", words);
    this.drawGhosts(this.held ? placesAt(parts, at) : new Map());
  }

  /** What is shown in time, and the present in it. */
  timeline() {
    if (this.plans.previewed.length) return { parts: ofPreview(this.plans.previewed), now: 0 };
    const seconds = Date.now() / 1000;
    const flown = [...this.store.plans.values()].filter((plan) => plan.start + plan.makespan > seconds);
    if (!flown.length) return { parts: [], now: 0 };
    const { start, parts } = ofPlans(flown);
    return { parts, now: Math.max(0, seconds - start) };
  }

  /** @param {Map<string, import("./types.js").TrackPoint>} points */
  drawGhosts(points) {
    const origin = this.store.origin;
    const state = JSON.stringify([[...points], origin]);
    if (state === this.shown) return;
    this.shown = state;
    this.layer.clearLayers();
    this.ghosts = origin ? [...points].map(([name, p]) => ({ name, colour: this.store.colourOf(name), place: toGlobal(origin, p[1], p[2]), height: -p[3] })) : [];
    for (const { name, colour, place, height } of this.ghosts) {
      const mark = L.circleMarker([place.lat, place.lon], { color: colour, radius: 9, weight: 3, fill: false, interactive: false, className: "ghost" });
      mark.addTo(this.layer).bindTooltip(make("span", "", `${name} ${fixed(height, 0)} m`), { permanent: true, direction: "right", className: "named" });
    }
  }
}
