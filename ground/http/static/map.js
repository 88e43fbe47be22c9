// The map: what it stands on (outline of the world, a square grid in metres), how it is moved, and its tools. What flies is
// drawn by fleetlayer.js, what is planned by planlayer.js.

import { byId, make, say } from "./dom.js";
import { polygonsOf, toNed, wayBetween } from "./geo.js";
import { L } from "./vendor.js";
import { t } from "./words.js";

/**
 * @typedef {import("./types.js").Place} Place
 * @typedef {{name: string, click: (place: Place) => void, move?: (place: Place) => void, end?: () => void}} Tool what a click means
 */

export const CLOSEST = 23;
const BUTTONS = 120; // pixels that the buttons take on the left, or at the top where it is narrow
const OUTLINE_TO = 11; // zoom up to which the outline of the world says anything: it is a kilometre coarse

export class FleetMap {
  /** @param {import("./store.js").Store} store @param {HTMLElement} element @param {HTMLElement} note */
  constructor(store, element, note) {
    this.store = store;
    this.note = note;
    this.element = element;
    this.map = L.map(element, {
      attributionControl: false, zoomControl: false, boxZoom: false, doubleClickZoom: false,
      zoomAnimation: false, fadeAnimation: false, markerZoomAnimation: false, // pictures are drawn by the processor here
      worldCopyJump: true, maxZoom: CLOSEST, minZoom: 1, zoomSnap: 0.5, center: [20, 0], zoom: 1,
    });
    this.map.createPane("world").style.zIndex = "150";
    this.land = L.polygon([], { pane: "world", renderer: L.canvas({ pane: "world" }), className: "land", weight: 1, interactive: false });
    this.scale = L.control.scale({ imperial: false, position: "bottomleft" }).addTo(this.map);
    this.grid = make("canvas", "grid");
    this.grid.setAttribute("aria-hidden", "true");
    element.prepend(this.grid);
    this.crosshair = make("div", "crosshair");
    this.crosshair.hidden = true;
    element.append(this.crosshair);
    this.following = true;
    this.fitted = this.drawn = false;
    this.wasNowhere = store.nowhere;
    /** @type {Place | null} where the grid begins while no origin is known */
    this.zero = null;
    /** @type {Tool | null} */
    this.tool = null;
    this.map.on("move zoomend resize", () => this.drawGrid());
    this.map.on("zoomend", () => this.drawOutline());
    this.map.on("dragstart", () => this.follow(false));
    this.map.on("click", (/** @type {any} */ event) => this.tool && this.tool.click({ lat: event.latlng.lat, lon: event.latlng.lng }));
    this.map.on("mousemove", (/** @type {any} */ event) => this.tool && this.tool.move && this.tool.move({ lat: event.latlng.lat, lon: event.latlng.lng }));
    element.addEventListener("keydown", (event) => this.aim(event));
    element.addEventListener("wheel", () => this.follow(false), { passive: true });
    this.paint();
    this.readOutline();
  }

  /** The outline of the world: the page is there before it. */
  async readOutline() {
    const answer = await fetch("static/vendor/land-110m.json");
    if (answer.ok) this.land.setLatLngs(polygonsOf(await answer.json()));
  }

  /** A colour of the style sheet's, for what is drawn on a canvas. @param {string} name */
  colour(name) {
    return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  }

  paint() {
    this.land.setStyle({ color: this.colour("--coast"), fillColor: this.colour("--land"), fillOpacity: 1 });
    this.drawOutline();
    this.drawGrid();
  }

  drawOutline() {
    const wanted = !this.store.nowhere || !this.store.all.some((vehicle) => vehicle.place);
    const shows = wanted && this.map.getZoom() <= OUTLINE_TO;
    this.element.classList.toggle("wide", shows);
    if (shows !== this.map.hasLayer(this.land)) shows ? this.land.addTo(this.map) : this.land.remove();
  }

  /** With a tool the space bar is a click at the middle of the map, which arrow keys move. @param {KeyboardEvent} event */
  aim(event) {
    if (event.target !== this.element) return;
    if (event.key.startsWith("Arrow")) this.follow(false);
    if (event.key !== " " || !this.tool) return;
    event.preventDefault();
    const middle = this.map.getCenter();
    this.tool.click({ lat: middle.lat, lon: middle.lng });
  }

  /** @param {boolean} on */
  follow(on) {
    this.following = on;
    byId("follow").setAttribute("aria-pressed", String(on));
  }

  /** Who is to stay in view: the selected, or all. */
  get shown() {
    const chosen = this.store.chosen.filter((vehicle) => vehicle.place);
    return chosen.length ? chosen : this.store.all.filter((vehicle) => vehicle.place);
  }

  get placesShown() {
    return this.shown.flatMap((vehicle) => vehicle.place || []);
  }

  /** Show these places with room around them. @param {Place[]} places */
  fit(places) {
    if (!places.length) return;
    const bounds = L.latLngBounds(places.map((place) => [place.lat, place.lon]));
    const middle = bounds.getCenter();
    this.map.fitBounds(bounds.extend(middle.toBounds(60)), { paddingTopLeft: this.map.getSize().x > 600 ? [BUTTONS, 50] : [50, BUTTONS], paddingBottomRight: [50, 50], maxZoom: CLOSEST - 1, animate: false });
    this.fitted = true;
  }

  draw() {
    const places = this.placesShown;
    const held = this.tool || document.body.classList.contains("leaflet-dragging"); // a place is meant where it is now
    if (places.length && (!this.fitted || (this.following && !held && !this.holds(places)))) this.fit(places);
    if (this.wasNowhere !== this.store.nowhere) {
      this.wasNowhere = this.store.nowhere;
      if (this.fitted) this.fit(places);
      this.drawOutline();
    }
    if (!this.drawn) this.drawGrid();
  }

  /** Everybody is in view, and the view is not far larger than they need. @param {Place[]} places */
  holds(places) {
    const view = this.map.getBounds();
    if (!places.every((place) => view.pad(-0.06).contains([place.lat, place.lon]))) return false;
    if (places.length < 2) return true;
    const need = L.latLngBounds(places.map((place) => [place.lat, place.lon])).pad(6);
    return need.getCenter().toBounds(200).contains(view) || need.getNorth() - need.getSouth() > view.getNorth() - view.getSouth() || need.getEast() - need.getWest() > view.getEast() - view.getWest() || this.map.getZoom() >= 18;
  }

  /** Squares of a round number of metres about the origin, as there may be no pictures of the ground. */
  drawGrid() {
    const size = this.map.getSize();
    const ratio = window.devicePixelRatio || 1;
    Object.assign(this.grid, { width: size.x * ratio, height: size.y * ratio });
    Object.assign(this.grid.style, { width: `${size.x}px`, height: `${size.y}px` });
    this.drawn = true;
    const middle = this.map.getCenter();
    const left = this.map.containerPointToLatLng([0, size.y / 2]);
    const right = this.map.containerPointToLatLng([size.x, size.y / 2]);
    const scale = size.x / wayBetween({ lat: middle.lat, lon: left.lng }, { lat: middle.lat, lon: Math.min(right.lng, left.lng + 179) }).distance; // pixels a metre
    const first = this.store.all.flatMap((vehicle) => vehicle.place || [])[0];
    if (!first || !Number.isFinite(scale) || scale < 1e-3) {
      say(this.note, first ? t("map.north") : t("map.nowhere"));
      return;
    }
    const rough = 70 / scale;
    const tens = 10 ** Math.floor(Math.log10(rough));
    const cell = [1, 2, 5, 10].map((n) => n * tens).find((n) => n >= rough) || rough;
    const origin = this.store.origin || (this.zero = this.zero || first);
    const [north, east] = toNed(origin, { lat: middle.lat, lon: middle.lng });
    const ink = this.grid.getContext("2d");
    ink.scale(ratio, ratio);
    ink.strokeStyle = this.colour("--grid");
    ink.beginPath();
    const west = east - size.x / 2 / scale;
    const south = north - size.y / 2 / scale;
    for (let e = Math.ceil(west / cell) * cell; (e - west) * scale < size.x; e += cell) {
      const x = Math.round((e - west) * scale) + 0.5;
      ink.moveTo(x, 0);
      ink.lineTo(x, size.y);
    }
    for (let n = Math.ceil(south / cell) * cell; (n - south) * scale < size.y; n += cell) {
      const y = Math.round(size.y - (n - south) * scale) + 0.5;
      ink.moveTo(0, y);
      ink.lineTo(size.x, y);
    }
    ink.stroke();
    const where = this.store.nowhere ? t("map.local") : t("map.north");
    say(this.note, t("map.square", { where, size: cell >= 1000 ? `${cell / 1000} km` : `${cell} m` }));
  }

  // Tools: a click on the map means something else until the tool ends.

  /** @param {string} words what a click does, shown over the map @param {Tool} tool */
  begin(words, tool) {
    this.end();
    this.tool = tool;
    this.element.classList.add("aiming");
    this.crosshair.hidden = false;
    this.element.focus({ preventScroll: true });
    say(byId("map-tool").firstElementChild, t("tool.words", { words }));
    byId("map-tool").hidden = false;
    for (const button of document.querySelectorAll("[data-tool]")) button.setAttribute("aria-pressed", String(/** @type {HTMLElement} */ (button).dataset.tool === tool.name));
  }

  end() {
    const tool = this.tool;
    this.tool = null;
    this.element.classList.remove("aiming");
    this.crosshair.hidden = true;
    byId("map-tool").hidden = true;
    for (const button of document.querySelectorAll("[data-tool]")) button.setAttribute("aria-pressed", "false");
    if (tool && tool.end) tool.end();
  }
}
