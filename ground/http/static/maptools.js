// What stands over the map: zoom, show all, follow, measure, and the box that selects.

import { byId, make } from "./dom.js";
import { wayBetween } from "./geo.js";
import { L } from "./vendor.js";
import { metres, t } from "./words.js";

/** @typedef {import("./types.js").Place} Place */

export class MapTools {
  /** @param {import("./store.js").Store} store @param {import("./map.js").FleetMap} map */
  constructor(store, map) {
    this.store = store;
    this.map = map;
    const on = (/** @type {string} */ id, /** @type {() => void} */ act) => byId(id).addEventListener("click", act);
    on("zoom-in", () => map.map.zoomIn());
    on("zoom-out", () => map.map.zoomOut());
    on("fit", () => map.fit(map.placesShown));
    on("follow", () => map.follow(!map.following));
    on("measure", () => this.measure());
    on("box", () => this.boxTool());
    on("map-tool-end", () => map.end());
    for (const id of ["zoom-in", "zoom-out"]) on(id, () => map.follow(false));
    this.rule();
    this.box();
  }

  rule() {
    this.line = L.polyline([], { color: this.map.colour("--accent"), weight: 2, dashArray: "6 5", interactive: false });
    this.words = L.tooltip({ permanent: true, direction: "top", className: "measured" });
  }

  /** Metres along the points that are clicked. */
  measure() {
    if (this.map.tool && this.map.tool.name === "measure") return this.map.end();
    /** @type {Place[]} */
    const points = [];
    const show = (/** @type {Place | null} */ place) => {
      const all = place ? [...points, place] : points;
      this.line.setLatLngs(all.map((each) => [each.lat, each.lon]));
      if (all.length < 2) return;
      const last = wayBetween(all[all.length - 2], all[all.length - 1]);
      const total = all.slice(1).reduce((sum, each, index) => sum + wayBetween(all[index], each).distance, 0);
      const leg = t("measure.leg", { metres: metres(last.distance), bearing: Math.round(last.bearing) % 360 });
      const text = all.length > 2 ? t("measure.all", { leg, metres: metres(total) }) : leg;
      this.words.setLatLng([all[all.length - 1].lat, all[all.length - 1].lon]).setContent(make("span", "", text)).addTo(this.map.map);
    };
    this.map.begin(t("measure.tool"), {
      name: "measure",
      click: (place) => {
        points.push(place);
        show(null);
      },
      move: (place) => {
        if (points.length) show(place);
      },
      end: () => {
        this.line.remove();
        this.words.remove();
        this.line.setLatLngs([]);
      },
    });
    this.line.addTo(this.map.map);
  }

  boxTool() {
    if (this.map.tool && this.map.tool.name === "box") return this.map.end();
    this.map.begin(t("box.tool"), { name: "box", click: () => {}, end: () => this.map.map.dragging.enable() });
    this.map.map.dragging.disable();
  }

  /** Shift and drag, or the tool and drag: selects who is inside. */
  box() {
    const element = this.map.element;
    const frame = make("div", "select-box");
    frame.hidden = true;
    element.append(frame);
    /** @type {[number, number] | null} */
    let from = null;
    const at = (/** @type {PointerEvent} */ event) => {
      const area = element.getBoundingClientRect();
      return /** @type {[number, number]} */ ([event.clientX - area.left, event.clientY - area.top]);
    };
    element.addEventListener("pointerdown", (event) => {
      const tool = this.map.tool && this.map.tool.name === "box";
      if (event.button !== 0 || !(tool || event.shiftKey) || /** @type {Element} */ (event.target).closest(".map-buttons, .leaflet-control")) return;
      event.preventDefault();
      event.stopPropagation();
      this.map.map.dragging.disable();
      element.setPointerCapture(event.pointerId);
      from = at(event);
    }, true);
    element.addEventListener("pointermove", (event) => {
      if (!from) return;
      const [x, y] = at(event);
      frame.hidden = false;
      Object.assign(frame.style, { left: `${Math.min(x, from[0])}px`, top: `${Math.min(y, from[1])}px`, width: `${Math.abs(x - from[0])}px`, height: `${Math.abs(y - from[1])}px` });
    });
    element.addEventListener("pointerup", (event) => {
      if (!from) return;
      const [x, y] = at(event);
      const area = L.bounds([from, [x, y]]);
      from = null;
      frame.hidden = true;
      this.map.map.dragging.enable();
      if (area.getSize().x < 4 && area.getSize().y < 4) return;
      const inside = this.store.all.filter((each) => each.place && area.contains(this.map.map.latLngToContainerPoint([each.place.lat, each.place.lon])));
      this.store.select(inside.map((each) => each.id));
      if (this.map.tool && this.map.tool.name === "box") this.map.end();
    });
  }
}
