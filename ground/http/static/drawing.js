// Drawing on the map: corners by clicks, moved by dragging, taken away with Delete; a list of what was drawn, and what is
// done with it.

import { confirmed } from "./ask.js";
import { byId, make, makeButton, saveFile, say, toast } from "./dom.js";
import { askPlanner, planFirst } from "./planner.js";
import { READ_ONLY } from "./settings.js";
import { commandOf, fenceTableOf, KIND_WORD, obstacleOf, planFileOf, Shapes } from "./shapes.js";
import { surveyForm } from "./survey.js";
import { L } from "./vendor.js";
import { t } from "./words.js";

/**
 * @typedef {import("./types.js").Place} Place
 * @typedef {import("./shapes.js").Shape} Shape
 * @typedef {import("./shapes.js").ShapeKind} ShapeKind
 * @typedef {"radius" | "floor" | "ceiling"} Measure
 */

const STEP = 4; // pixels that an arrow key moves a corner by
/** @type {ShapeKind[]} */
const KINDS = ["search", "no_fly", "geofence", "obstacle"];

export class Drawing {
  /** @param {import("./store.js").Store} store @param {import("./map.js").FleetMap} view @param {import("./planlayer.js").PlanLayer} plans */
  constructor(store, view, plans) {
    this.store = store;
    this.view = view;
    this.plans = plans;
    this.shapes = new Shapes();
    this.layer = L.layerGroup().addTo(view.map);
    /** @type {[any, string][]} the names on the map, and whose they are */
    this.names = [];
    /** @type {number | null} whose corners can be moved */
    this.editing = null;
    /** @type {(() => void) | null} closes the area that is being drawn */
    this.finish = null;
    this.list = make("ol", "shapes");
    const tool = (/** @type {ShapeKind} */ kind) => {
      const button = makeButton(KIND_WORD[kind], "small", () => this.begin(kind), kind === "obstacle" ? t("draw.centre.title") : t("draw.corners.title"));
      button.dataset.tool = kind;
      return button;
    };
    this.undo = makeButton(t("draw.undo"), "small", () => this.back(), t("draw.undo.title"));
    this.saves = makeButton(t("draw.plan"), "small", () => saveFile("fence.plan", JSON.stringify(planFileOf(this.shapes.all), null, 2)), t("draw.plan.title"));
    byId("drawing").append(make("div", "orders", "", ...KINDS.map(tool), this.undo, this.saves), this.list);
    document.addEventListener("keydown", (event) => {
      if (event.target instanceof HTMLInputElement) return;
      if ((event.ctrlKey || event.metaKey) && event.key === "z") this.back();
      if (event.key === "Enter" && this.finish && !(event.target instanceof HTMLButtonElement)) this.finish();
    });
    this.refresh();
  }

  back() {
    this.shapes.undo();
    this.refresh();
  }

  /** @param {ShapeKind} kind */
  begin(kind) {
    if (this.view.tool && this.view.tool.name === kind) return this.view.end();
    /** @type {Place[]} */
    const points = [];
    const style = { color: this.colourOf(kind), weight: 2, dashArray: "4 4", interactive: false };
    const line = L.polyline([], style).addTo(this.view.map);
    const first = L.circleMarker([0, 0], { ...style, dashArray: null, radius: 7, fillOpacity: 0.4 });
    const finish = () => {
      if (points.length < 3) return void toast(t("draw.three"), "warn");
      this.view.end();
      this.editing = this.shapes.add(kind, points).id;
      this.refresh();
    };
    const words = kind === "obstacle" ? t("draw.centre.tool") : t("draw.corners.tool", { kind: KIND_WORD[kind] });
    this.view.begin(words, {
      name: kind,
      click: (place) => {
        if (kind === "obstacle") {
          points.push(place);
          this.view.end();
          this.editing = this.shapes.add(kind, points).id;
          return this.refresh();
        }
        if (points.length > 2 && this.near(points[0], place)) return finish();
        points.push(place);
        first.setLatLng([points[0].lat, points[0].lon]).addTo(this.view.map);
        line.setLatLngs(points.map((each) => [each.lat, each.lon]));
      },
      move: (place) => {
        if (points.length) line.setLatLngs([...points, place].map((each) => [each.lat, each.lon]));
      },
      end: () => {
        line.remove();
        first.remove();
        this.finish = null;
      },
    });
    this.finish = kind === "obstacle" ? null : finish;
  }

  /** Within some pixels on the screen. @param {Place} a @param {Place} b */
  near(a, b) {
    const [p, q] = [a, b].map((each) => this.view.map.latLngToContainerPoint([each.lat, each.lon]));
    return p.distanceTo(q) < 14;
  }

  /** @param {ShapeKind} kind */
  colourOf(kind) {
    return this.view.colour({ no_fly: "--keepout", obstacle: "--keepout", geofence: "--fence", search: "--accent" }[kind]);
  }

  /** Where the planner keeps clear of one, its own name of it stands there. What is dragged is not drawn anew for that. */
  draw() {
    for (const [label, name] of this.names) this.store.origin && this.store.obstacles.has(name) ? this.layer.removeLayer(label) : this.layer.addLayer(label);
  }

  drawShapes() {
    this.layer.clearLayers();
    this.names = [];
    for (const shape of this.shapes.all) this.drawShape(shape);
    this.draw();
  }

  refresh() {
    this.drawShapes();
    this.list.replaceChildren(...this.shapes.all.map((shape) => this.row(shape)));
    if (!this.shapes.all.length) this.list.append(make("li", "muted", t("draw.none")));
    this.undo.disabled = !this.shapes.past.length;
    this.saves.disabled = !this.shapes.all.some((each) => each.kind !== "search");
    say(byId("drawing-count"), this.shapes.all.length ? String(this.shapes.all.length) : "");
  }

  /** @param {Shape} shape */
  drawShape(shape) {
    const editing = this.editing === shape.id;
    const style = { color: this.colourOf(shape.kind), weight: editing ? 3 : 2, dashArray: shape.kind === "geofence" ? "12 6" : null, fillOpacity: shape.kind === "geofence" ? 0 : 0.1, bubblingMouseEvents: true };
    const corners = shape.points.map((point) => /** @type {[number, number]} */ ([point.lat, point.lon]));
    const drawn = shape.kind === "obstacle" ? L.circle(corners[0], { ...style, radius: shape.radius }) : L.polygon(corners, style);
    drawn.addTo(this.layer);
    this.names.push([L.tooltip({ permanent: true, direction: "top", offset: [0, -8], className: "named" }).setLatLng(corners[0]).setContent(make("span", "", shape.name)), shape.name]);
    drawn.on("click", () => {
      if (this.view.tool) return;
      this.editing = shape.id;
      this.refresh();
    });
    this.handles(shape, drawn);
  }

  /** What moves the corners of the one that is edited. @param {Shape} shape @param {any} drawn */
  handles(shape, drawn) {
    if (this.editing !== shape.id) return;
    shape.points.forEach((point, index) => this.corner(shape, drawn, index, point, false));
    if (shape.kind === "obstacle") return;
    shape.points.forEach((point, index) => {
      const next = shape.points[(index + 1) % shape.points.length];
      this.corner(shape, drawn, index + 1, { lat: (point.lat + next.lat) / 2, lon: (point.lon + next.lon) / 2 }, true);
    });
  }

  /**
   * A handle at a corner, or between two, where one is made by dragging it.
   * @param {Shape} shape @param {any} drawn @param {number} index @param {Place} point @param {boolean} between
   */
  corner(shape, drawn, index, point, between) {
    const icon = L.divIcon({ className: between ? "corner between" : "corner", iconSize: between ? [12, 12] : [16, 16] });
    const handle = L.marker([point.lat, point.lon], { icon, draggable: true, keyboard: true, corner: between ? null : index, title: between ? t("draw.between") : t("draw.corner"), alt: t("draw.corner.name", { name: shape.name }) }).addTo(this.layer);
    const moved = (/** @type {{lat: number, lng: number}} */ latlng) => {
      const points = [...shape.points];
      points.splice(index, between ? 0 : 1, { lat: latlng.lat, lon: latlng.lng });
      return points;
    };
    handle.on("drag", () => {
      const points = moved(handle.getLatLng()).map((each) => [each.lat, each.lon]);
      shape.kind === "obstacle" ? drawn.setLatLng(points[0]) : drawn.setLatLngs(points);
    });
    handle.on("dragend", () => {
      const points = moved(handle.getLatLng());
      this.shapes.change(() => (shape.points = points));
      this.refresh();
    });
    const remove = () => {
      if (between || shape.points.length < 4) return toast(t("draw.three"), "warn");
      this.shapes.change(() => shape.points.splice(index, 1));
      this.refresh();
    };
    handle.on("contextmenu", remove);
    handle.on("keydown", (/** @type {any} */ event) => {
      const [dx, dy] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[/** @type {string} */ (event.originalEvent.key)] || [0, 0];
      if (event.originalEvent.key === "Delete") remove();
      if (!dx && !dy) return;
      event.originalEvent.stopPropagation();
      event.originalEvent.preventDefault();
      const pixels = this.view.map.latLngToContainerPoint(handle.getLatLng()).add([STEP * dx, STEP * dy]);
      const points = moved(this.view.map.containerPointToLatLng(pixels));
      this.shapes.change(() => (shape.points = points));
      this.refresh();
      this.layer.getLayers().find((/** @type {any} */ each) => each.options.corner === index)?.getElement().focus();
    });
  }

  /** @param {Shape} shape */
  row(shape) {
    const number = (/** @type {string} */ label, /** @type {Measure} */ field) => {
      const input = make("input");
      Object.assign(input, { type: "number", step: "any", value: String(shape[field]) });
      input.addEventListener("change", () => {
        const value = Number(input.value);
        if (input.value === "" || !Number.isFinite(value) || (field === "radius" && value <= 0)) return this.refresh();
        this.shapes.change(() => (shape[field] = value));
        this.refresh();
      });
      return make("label", "", "", `${label} `, input, " m");
    };
    const name = make("input", "shape-name");
    name.value = shape.name;
    name.setAttribute("aria-label", t("draw.name"));
    name.addEventListener("change", () => {
      if (!/^[A-Za-z0-9_-]{1,40}$/.test(name.value)) return toast(t("draw.name.wrong"), "bad"), this.refresh();
      this.shapes.change(() => (shape.name = name.value));
      this.refresh();
    });
    const numbers = shape.kind === "search" ? [number(t("draw.flown"), "ceiling")] : [...(shape.kind === "obstacle" ? [number(t("draw.radius"), "radius")] : []), number(t("draw.floor"), "floor"), number(t("draw.ceiling"), "ceiling")];
    const row = make("li", this.editing === shape.id ? "editing" : "", "", make("div", "shape-head", "", make("b", "", KIND_WORD[shape.kind]), name), make("div", "shape-numbers", "", ...numbers), make("div", "orders", "", ...this.acts(shape)), ...(!READ_ONLY && shape.kind === "search" ? [surveyForm(this, shape)] : []));
    row.addEventListener("focusin", () => {
      if (this.editing === shape.id) return;
      this.editing = shape.id;
      this.drawShapes();
    });
    return row;
  }

  /** @param {Shape} shape */
  acts(shape) {
    const acts = [];
    if (!READ_ONLY && shape.kind === "search") acts.push(makeButton(t("draw.fly"), "small safe", () => this.search(shape), t("draw.fly.title")));
    if (!READ_ONLY && shape.kind !== "search") acts.push(makeButton(t("draw.give"), "small safe", () => this.give(shape), t("draw.give.title")));
    acts.push(makeButton(t("draw.copy"), "small", () => this.copy(shape), t("draw.copy.title")));
    if (shape.kind === "geofence") acts.push(makeButton(t("draw.toml"), "small", () => saveFile(`${shape.name}.toml`, fenceTableOf(shape)), t("draw.toml.title")));
    acts.push(makeButton(t("draw.delete"), "small", () => (this.shapes.remove(shape), this.refresh())));
    return acts;
  }

  get origin() {
    if (!this.store.origin) toast(t("draw.no-origin"), "bad", 12000);
    return this.store.origin;
  }

  /** @param {Shape} shape */
  async search(shape) {
    const origin = this.origin;
    if (!origin) return;
    const vehicles = this.store.chosen.map((vehicle) => vehicle.name);
    if (!vehicles.length) return toast(t("draw.who"), "bad");
    const { polygon } = obstacleOf(shape, origin).what;
    await planFirst({ kind: "search", vehicles, polygon, height: shape.ceiling }, this.plans);
  }

  /** @param {Shape} shape */
  async give(shape) {
    const origin = this.origin;
    if (!origin) return;
    const text = shape.kind === "geofence" ? t("give.fence") : t("give.text");
    if (await confirmed(t("give.title", { kind: KIND_WORD[shape.kind], name: shape.name }), text, t("give.yes"))) await askPlanner("obstacle", { obstacle: obstacleOf(shape, origin) });
  }

  /** @param {Shape} shape */
  async copy(shape) {
    const origin = this.origin;
    if (!origin) return;
    const line = commandOf(shape, origin, this.store.chosen.map((vehicle) => vehicle.name));
    try {
      await navigator.clipboard.writeText(line);
      toast(t("draw.copied", { line }), "good");
    } catch (error) {
      toast(line, "", 30000); // no clipboard without TLS or beyond this computer: to be copied by hand
    }
  }
}
