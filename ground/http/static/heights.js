// The side view: heights above the fleet's origin over what the map shows from west to east, each below its mark.

import { byId, keep, kept } from "./dom.js";
import { toGlobal } from "./geo.js";
import { LEVELS, t } from "./words.js";

/** @typedef {import("./types.js").Place} Place @typedef {{x: number, height: number}} Point of the view: pixels, m */

const TALL = 130; // pixels
const BELOW = 14; // pixels below the lowest

export class Heights {
  /** @param {import("./store.js").Store} store @param {import("./map.js").FleetMap} view @param {import("./planlayer.js").PlanLayer} plans @param {import("./scrub.js").Scrubber} scrubber */
  constructor(store, view, plans, scrubber) {
    this.store = store;
    this.view = view;
    this.plans = plans;
    this.scrubber = scrubber;
    this.canvas = byId("heights");
    this.ink = this.canvas.getContext("2d");
    /** @type {(Point & {name: string})[]} the vehicles as they were drawn last */
    this.marks = [];
    this.top = this.bottom = 0;
    /** Longitude of the left edge, and pixels a degree. */
    this.west = this.scale = 0;
    byId("heights-button").addEventListener("click", () => this.show(this.canvas.hidden));
    view.map.on("move zoomend resize", () => this.draw());
    this.show(kept("heights", false));
  }

  /** @param {boolean} on */
  show(on) {
    if (on !== kept("heights", false)) keep("heights", on);
    this.canvas.hidden = !on;
    byId("heights-button").setAttribute("aria-pressed", String(on));
    byId("map-panel").classList.toggle("with-heights", on);
    this.view.map.invalidateSize();
    this.draw();
  }

  /** On Mercator's map east goes with the longitude alone. @param {Place} place */
  x(place) {
    return (place.lon - this.west) * this.scale;
  }

  /** @param {number} height */
  y(height) {
    return TALL - BELOW - ((height - this.bottom) / (this.top - this.bottom)) * (TALL - BELOW - 16);
  }

  draw() {
    if (this.canvas.hidden) return;
    const width = this.view.map.getSize().x;
    const [left, right] = [0, width].map((x) => this.view.map.containerPointToLatLng([x, 0]).lng);
    [this.west, this.scale] = [left, width / (right - left)];
    const ratio = window.devicePixelRatio || 1;
    Object.assign(this.canvas, { width: width * ratio, height: TALL * ratio });
    this.canvas.style.height = `${TALL}px`;
    this.ink.scale(ratio, ratio);
    const tracks = this.store.all.map((vehicle) => ({ colour: vehicle.colour, points: vehicle.trail.flatMap((p) => (p.alt === null ? [] : [{ x: this.x(p), height: p.alt }])) }));
    const ways = this.ways();
    this.marks = this.store.all.flatMap((vehicle) => (vehicle.place && vehicle.above !== null ? [{ name: vehicle.name, x: this.x(vehicle.place), height: vehicle.above }] : []));
    const inView = (/** @type {Point} */ point) => point.x > 0 && point.x < width;
    const all = [...this.marks, ...tracks.flatMap((each) => each.points), ...ways.flatMap((each) => each.points)].filter(inView).map((each) => each.height);
    this.top = Math.max(10, ...all) * 1.05;
    this.bottom = Math.min(0, ...all);
    this.grid(width);
    this.drawKeptClear();
    for (const each of tracks) this.line(each.points, each.colour, []);
    for (const each of ways) this.line(each.points, each.colour, [5, 4]);
    for (const ghost of this.scrubber.ghosts) this.dot({ x: this.x(ghost.place), height: ghost.height }, ghost.colour, false);
    for (const mark of this.marks) this.dot(mark, this.store.colourOf(mark.name), true);
    this.names();
    this.canvas.setAttribute("aria-label", t("heights.label", { count: this.marks.length, top: Math.round(this.top) }));
  }

  /** Planned: what is flown, and what a preview shows. @returns {{colour: string, points: Point[]}[]} */
  ways() {
    const origin = this.store.origin;
    if (!origin) return [];
    const tracks = [...this.store.plans.values(), ...this.plans.previewed].flatMap((each) => Object.entries(each.tracks || {}));
    return tracks.map(([name, track]) => ({ colour: this.store.colourOf(name), points: track.map((p) => ({ x: this.x(toGlobal(origin, p[1], p[2])), height: -p[3] })) }));
  }

  /** @param {number} width */
  grid(width) {
    const rough = (this.top - this.bottom) / 3;
    const tens = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((n) => n * tens).find((n) => n >= rough) || rough;
    this.ink.font = `12px ${getComputedStyle(document.body).fontFamily}`;
    for (let height = Math.ceil(this.bottom / step) * step; height <= this.top; height += step) {
      this.ink.strokeStyle = this.view.colour(height === 0 ? "--muted" : "--grid");
      this.ink.fillStyle = this.view.colour("--muted");
      this.ink.beginPath();
      this.ink.moveTo(0, Math.round(this.y(height)) + 0.5);
      this.ink.lineTo(width, Math.round(this.y(height)) + 0.5);
      this.ink.stroke();
      this.ink.fillText(`${Number(height.toFixed(3))} m`, 4, this.y(height) - 3);
    }
  }

  /** What is kept clear of, from its floor to its ceiling; a fence is what surrounds the rest. */
  drawKeptClear() {
    const origin = this.store.origin;
    if (!origin) return;
    for (const { what } of this.store.obstacles.values()) {
      const [low, high, center] = [what.low, what.high, what.center];
      const r = what.radius || 0;
      const corners = what.polygon || (low && high ? [low, high] : center ? [[center[0], center[1] - r], [center[0], center[1] + r]] : []);
      const xs = corners.map((corner) => this.x(toGlobal(origin, corner[0], corner[1])));
      if (!xs.length) continue;
      const ball = what.shape === "ball" && center ? [-center[2] - r, -center[2] + r] : null;
      const [floor, ceiling] = ball || (low && high ? [-high[2], -low[2]] : [what.floor ?? this.bottom, what.ceiling ?? this.top]);
      const [y0, y1] = [this.y(Math.min(ceiling, 2 * this.top)), this.y(Math.max(floor, this.bottom))];
      this.ink.fillStyle = this.ink.strokeStyle = this.view.colour(what.shape === "geofence" ? "--fence" : "--keepout");
      this.ink.globalAlpha = what.shape === "geofence" ? 1 : 0.18;
      const area = /** @type {[number, number, number, number]} */ ([Math.min(...xs), y0, Math.max(...xs) - Math.min(...xs), y1 - y0]);
      what.shape === "geofence" ? this.ink.strokeRect(...area) : this.ink.fillRect(...area);
      this.ink.globalAlpha = 1;
    }
  }

  /** @param {Point[]} points @param {string} colour @param {number[]} dash */
  line(points, colour, dash) {
    this.ink.strokeStyle = colour;
    this.ink.setLineDash(dash);
    this.ink.beginPath();
    for (const point of points) this.ink.lineTo(point.x, this.y(point.height));
    this.ink.stroke();
    this.ink.setLineDash([]);
  }

  /** @param {Point} point @param {string} colour @param {boolean} filled */
  dot(point, colour, filled) {
    this.ink.fillStyle = this.ink.strokeStyle = colour;
    this.ink.lineWidth = 2;
    this.ink.beginPath();
    this.ink.arc(point.x, this.y(point.height), 5, 0, 7);
    filled ? this.ink.fill() : this.ink.stroke();
    this.ink.lineWidth = 1;
  }

  /** Beside each mark where there is room: the selected and those in trouble first. */
  names() {
    const rank = (/** @type {string} */ name) => {
      const vehicle = this.store.named(name);
      return !vehicle ? 9 : this.store.selected.has(vehicle.id) ? 0 : 1 + LEVELS.indexOf(vehicle.level);
    };
    const taken = this.marks.map((mark) => [mark.x - 6, this.y(mark.height) - 6, mark.x + 6, this.y(mark.height) + 6]);
    this.ink.fillStyle = this.view.colour("--text");
    for (const mark of [...this.marks].sort((a, b) => rank(a.name) - rank(b.name))) {
      const wide = this.ink.measureText(mark.name).width;
      const box = [mark.x + 8, this.y(mark.height) - 7, mark.x + 10 + wide, this.y(mark.height) + 7];
      if (taken.some((other) => box[2] > other[0] && box[0] < other[2] && box[3] > other[1] && box[1] < other[3])) continue;
      taken.push(box);
      this.ink.fillText(mark.name, mark.x + 9, this.y(mark.height) + 4);
    }
  }
}
