// The vehicles on the map: where they are, look and go, what they are, their tracks, homes, targets and links.

import { byId, make, mark, say } from "./dom.js";
import { L } from "./vendor.js";
import { fixed, LEVEL_WORD, LEVELS, t } from "./words.js";

/**
 * @typedef {import("./types.js").Place} Place
 * @typedef {import("./vehicle.js").Vehicle} Vehicle
 * @typedef {[number, number, number, number]} Box left, top, right, bottom
 */

const SVG = "http://www.w3.org/2000/svg";
/** Outlines about the middle, pointing north, by kind. @type {Record<string, string>} */
const SHAPES = {
  copter: "M0-11 3-4 7-8A3 3 0 1 1 9-5L4 0 9 5A3 3 0 1 1 7 8L3 5H-3L-7 8A3 3 0 1 1-9 5L-4 0-9-5A3 3 0 1 1-7-8L-3-4Z",
  plane: "M0-12 2-4 12 2V5L2 3 1 8 5 10V12L0 11-5 12V10L-1 8-2 3-12 5V2L-2-4Z",
  rover: "M0-11 5-6H7V-1H5V3H7V9H-7V3H-5V-1H-7V-6H-5Z",
  boat: "M0-12Q8-3 6 10H-6Q-8-3 0-12Z",
  other: "M0-11 8 9 0 5-8 9Z",
};
const TRAIL_MS = 120000; // of a track
/** @type {Record<string, string>} */
const GRADE_COLOUR = { good: "--good", fair: "--warn", poor: "--bad", down: "--bad", unknown: "--muted" };
const SIDES = [[14, -9], [14, 6], [-14, -9], [-14, 6], [0, -30], [0, 16], [18, -24], [-18, -24], [18, 20], [-18, 20]];

/** What a kind of vehicle is drawn by, pointing north. @param {string} kind @param {string} colour */
export function outlineOf(kind, colour) {
  const [svg, shape] = [document.createElementNS(SVG, "svg"), document.createElementNS(SVG, "path")];
  svg.setAttribute("viewBox", "-16 -16 32 32");
  shape.setAttribute("d", SHAPES[kind] || SHAPES.other);
  shape.setAttribute("fill", colour);
  svg.append(shape);
  return { svg, shape };
}

export class FleetLayer {
  /** @param {import("./store.js").Store} store @param {import("./map.js").FleetMap} view */
  constructor(store, view) {
    this.store = store;
    this.view = view;
    this.map = view.map;
    this.canvas = L.canvas({ padding: 0.2 });
    /** @type {Map<string, any>} what is drawn of each vehicle */
    this.drawn = new Map();
    /** @type {Map<string, any>} lines between routers */
    this.lines = new Map();
    this.labels = make("div", "labels");
    this.labels.setAttribute("aria-hidden", "true");
    view.element.append(this.labels);
    this.ink = make("canvas").getContext("2d");
    this.ink.font = `700 13px ${getComputedStyle(document.body).fontFamily}`;
    this.tracksAt = 0;
    this.map.on("move zoom", () => this.placeLabels());
  }

  draw() {
    const tracks = Date.now() - this.tracksAt > 900;
    if (tracks) this.tracksAt = Date.now();
    for (const vehicle of this.store.all) {
      try {
        if (vehicle.place) this.vehicle(vehicle, vehicle.place, tracks);
      } catch (error) {
        // A state that is not as it should be spoils its own mark and no other; its card says so.
      }
    }
    if (tracks) this.links();
    this.placeLabels();
  }

  /** @param {Vehicle} vehicle @param {Place} place */
  make(vehicle, place) {
    const { svg, shape } = outlineOf(vehicle.state.kind || "", vehicle.colour);
    const circle = (/** @type {number} */ radius, /** @type {string} */ name) => {
      const made = document.createElementNS(SVG, "circle");
      made.setAttribute("r", String(radius));
      made.setAttribute("class", name);
      return made;
    };
    svg.prepend(circle(19, "halo"), circle(15, "ring"));
    const icon = L.divIcon({ className: "craft", html: svg, iconSize: [34, 34] });
    const marker = L.marker([place.lat, place.lon], { icon, keyboard: true, title: vehicle.name, alt: vehicle.name }).addTo(this.map);
    marker.on("click", (/** @type {any} */ event) => this.clicked(vehicle, event));
    marker.on("keypress", (/** @type {any} */ event) => event.originalEvent.key === "Enter" && this.store.select([vehicle.id]));
    const track = L.polyline([], { renderer: this.canvas, weight: 2, opacity: 0.75, interactive: false, smoothFactor: 1.5 }).addTo(this.map);
    const thin = { renderer: this.canvas, weight: 1.5, interactive: false };
    const home = L.circleMarker([0, 0], { ...thin, radius: 4, fillOpacity: 0.9, fillColor: this.view.colour("--panel") });
    const aim = L.polyline([], { ...thin, dashArray: "2 6" });
    const label = make("span", "label");
    this.labels.append(label);
    const drawn = { marker, svg, shape, track, home, aim, label, colour: "" };
    this.drawn.set(vehicle.id, drawn);
    return drawn;
  }

  /** @param {Vehicle} vehicle @param {any} event of Leaflet */
  clicked(vehicle, event) {
    if (this.view.tool) return this.view.tool.click({ lat: event.latlng.lat, lon: event.latlng.lng });
    const keys = event.originalEvent;
    if (keys.ctrlKey || keys.metaKey || keys.shiftKey) this.store.toggle(vehicle.id);
    else this.store.select([vehicle.id]);
  }

  /** @param {Vehicle} vehicle @param {Place} place @param {boolean} tracks draw these too */
  vehicle(vehicle, place, tracks) {
    const drawn = this.drawn.get(vehicle.id) || this.make(vehicle, place);
    const here = [place.lat, place.lon];
    drawn.marker.setLatLng(here);
    drawn.svg.style.transform = `rotate(${vehicle.heading}rad)`;
    const element = drawn.marker.getElement();
    const level = vehicle.level;
    for (const [name, on] of Object.entries({ selected: this.store.selected.has(vehicle.id), stale: vehicle.stale, bad: level === "bad", warn: level === "warn", armed: vehicle.state.armed === true }))
      element.classList.toggle(name, on);
    mark(element, "aria-label", t("craft.name", { name: vehicle.name, mode: vehicle.state.mode || "–", level: LEVEL_WORD[level] }));
    say(drawn.label, vehicle.height === null ? vehicle.name : `${vehicle.name} ${fixed(vehicle.height, 0)} m`);
    if (drawn.colour !== vehicle.colour) {
      drawn.colour = vehicle.colour;
      drawn.shape.setAttribute("fill", vehicle.colour);
      for (const each of [drawn.track, drawn.home, drawn.aim]) each.setStyle({ color: vehicle.colour });
    }
    if (!tracks) return;
    const since = Date.now() - TRAIL_MS;
    drawn.track.setLatLngs([...vehicle.trail.filter((point) => point.at > since).map((point) => [point.lat, point.lon]), here]);
    if (vehicle.home) drawn.home.setLatLng([vehicle.home.lat, vehicle.home.lon]).addTo(this.map);
    const aim = vehicle.state.armed ? vehicle.aim : null;
    drawn.aim.setLatLngs(aim ? [here, [aim.lat, aim.lon]] : []).addTo(this.map);
  }

  /** Pixels that the ring about it reaches further than its mark. @param {Vehicle} vehicle */
  ring(vehicle) {
    return this.store.selected.has(vehicle.id) ? 8 : vehicle.level === "bad" || vehicle.level === "warn" ? 4 : 0;
  }

  /** Links between routers whose places are known, by their quality. */
  links() {
    const places = new Map(this.store.all.flatMap(({ name, id, place }) => /** @type {[string, Place][]} */ (place ? [[name, place], [id, place]] : [])));
    const there = new Set();
    for (const link of byId("show-links").checked ? this.store.links : []) {
      const [a, b] = [places.get(link.a), places.get(link.b)];
      if (!a || !b) continue;
      const key = `${link.a} ${link.b}`;
      there.add(key);
      const line = this.lines.get(key) || L.polyline([], { renderer: this.canvas, weight: 3, opacity: 0.55, interactive: false }).addTo(this.map);
      this.lines.set(key, line);
      line.setLatLngs([[a.lat, a.lon], [b.lat, b.lon]]).setStyle({ color: this.view.colour(GRADE_COLOUR[link.grade] || "--muted"), dashArray: link.grade === "down" ? "3 8" : null });
      line.bringToBack();
    }
    for (const [key, line] of this.lines) {
      if (there.has(key)) continue;
      line.remove();
      this.lines.delete(key);
    }
  }

  /** What stands on the map already: names of shapes, and the buttons. @returns {Box[]} */
  covered() {
    const frame = this.map.getContainer().getBoundingClientRect();
    const all = byId("map-frame");
    return [...all.querySelectorAll(".leaflet-tooltip"), ...all.querySelectorAll(".map-buttons>button")].map((each) => {
      const box = each.getBoundingClientRect();
      return [box.left - frame.left, box.top - frame.top, box.right - frame.left, box.bottom - frame.top];
    });
  }

  /** Beside each vehicle, on the first side that is free; the selected and those in trouble first. None is better than two in one place. */
  placeLabels() {
    const taken = this.covered();
    /** @type {Map<Vehicle, {x: number, y: number}>} */
    const points = new Map();
    for (const vehicle of this.store.all) {
      const drawn = this.drawn.get(vehicle.id);
      if (!drawn || !vehicle.place) continue;
      const point = this.map.latLngToContainerPoint([vehicle.place.lat, vehicle.place.lon]);
      points.set(vehicle, point);
      const reach = 9 + this.ring(vehicle);
      taken.push([point.x - reach, point.y - reach, point.x + reach, point.y + reach]);
    }
    const rank = (/** @type {Vehicle} */ vehicle) => (this.store.selected.has(vehicle.id) ? 0 : 1 + LEVELS.indexOf(vehicle.level));
    const size = this.map.getSize();
    const inside = (/** @type {Box} */ box) => box[0] >= 2 && box[1] >= 2 && box[2] <= size.x - 2 && box[3] <= size.y - 2;
    const free = (/** @type {Box} */ box) => taken.every((other) => box[2] <= other[0] || box[0] >= other[2] || box[3] <= other[1] || box[1] >= other[3]);
    for (const [vehicle, point] of [...points].sort((a, b) => rank(a[0]) - rank(b[0]))) {
      const label = this.drawn.get(vehicle.id).label;
      const width = this.ink.measureText(label.textContent).width + 4;
      const more = this.ring(vehicle);
      const boxes = SIDES.map(([sx, sy]) => {
        const [dx, dy] = sx ? [sx + more * Math.sign(sx), sy] : [0, sy + more * Math.sign(sy)];
        const left = dx > 0 ? point.x + dx : dx < 0 ? point.x + dx - width : point.x - width / 2;
        return /** @type {Box} */ ([left, point.y + dy, left + width, point.y + dy + 15]);
      });
      const box = boxes.find((each) => inside(each) && free(each));
      label.hidden = !box;
      label.classList.toggle("selected", this.store.selected.has(vehicle.id));
      if (!box) continue;
      taken.push(box);
      label.style.transform = `translate(${Math.round(box[0])}px, ${Math.round(box[1])}px)`;
    }
  }
}
