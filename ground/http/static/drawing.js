"use strict";
// Drawing on the map: corners by clicks, moved by dragging, taken away with Delete; a list of what was drawn, and what is
// done with it.

class Drawing {
  /** @param {Store} store @param {FleetMap} view @param {PlanLayer} plans */
  constructor(store, view, plans) {
    this.store = store;
    this.view = view;
    this.plans = plans;
    this.shapes = new Shapes();
    this.layer = L.layerGroup().addTo(view.map);
    /** @type {number | null} whose corners can be moved */
    this.editing = null;
    this.list = make("ol", "shapes");
    const tool = (kind) => {
      const button = makeButton(KIND_WORD[kind], "small", () => this.begin(kind), kind === "obstacle" ? "a click is its centre" : "click its corners; Enter or a click on the first one ends it");
      button.dataset.tool = kind;
      return button;
    };
    this.undo = makeButton("Undo", "small", () => this.back(), "take the last change back (ctrl+Z)");
    this.saves = makeButton("Save .plan", "small", () => saveFile("fence.plan", JSON.stringify(planFileOf(this.shapes.all), null, 2)), "fences and no-fly areas: zmav mission upload NAME fence.plan");
    byId("drawing").append(make("div", "orders", "", ...["search", "no_fly", "geofence", "obstacle"].map(tool), this.undo, this.saves), this.list);
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
      if (points.length < 3) return toast("An area has three corners or more", "warn");
      this.view.end();
      this.editing = this.shapes.add(kind, points).id;
      this.refresh();
    };
    const words = kind === "obstacle" ? "Click the obstacle's centre; Esc ends it" : `Click the corners of the ${KIND_WORD[kind]}; Enter, or a click on the first one, closes it; Esc drops it`;
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
      move: (place) => points.length && line.setLatLngs([...points, place].map((each) => [each.lat, each.lon])),
      end: () => {
        line.remove();
        first.remove();
        this.finish = null;
      },
    });
    this.finish = kind === "obstacle" ? null : finish;
  }

  /** Within some pixels on the screen. */
  near(a, b) {
    const [p, q] = [a, b].map((each) => this.view.map.latLngToContainerPoint([each.lat, each.lon]));
    return p.distanceTo(q) < 14;
  }

  /** @param {ShapeKind} kind */
  colourOf(kind) {
    return this.view.colour({ no_fly: "--keepout", obstacle: "--keepout", geofence: "--fence", search: "--accent" }[kind]);
  }

  refresh() {
    this.layer.clearLayers();
    for (const shape of this.shapes.all) this.drawShape(shape);
    this.list.replaceChildren(...this.shapes.all.map((shape) => this.row(shape)));
    if (!this.shapes.all.length) this.list.append(make("li", "muted", "Nothing drawn yet. What is drawn here stays in this browser until it is given to the planner or saved."));
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
    const name = L.tooltip({ permanent: true, direction: "top", offset: [0, -8], className: "named" }).setLatLng(corners[0]).setContent(make("span", "", shape.name));
    if (!this.store.obstacles.has(shape.name)) name.addTo(this.layer); // else the planner's own has it
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

  /** A handle at a corner, or between two, where one is made by dragging it. */
  corner(shape, drawn, index, point, between) {
    const icon = L.divIcon({ className: between ? "corner between" : "corner", iconSize: between ? [12, 12] : [16, 16] });
    const handle = L.marker([point.lat, point.lon], { icon, draggable: true, keyboard: true, title: between ? "drag: a new corner" : "drag it; Delete takes it away", alt: `corner of ${shape.name}` }).addTo(this.layer);
    const moved = (latlng) => {
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
      if (between || shape.points.length < 4) return toast("An area has three corners or more", "warn");
      this.shapes.change(() => shape.points.splice(index, 1));
      this.refresh();
    };
    handle.on("contextmenu", remove);
    handle.on("keydown", (event) => event.originalEvent.key === "Delete" && remove());
  }

  /** @param {Shape} shape */
  row(shape) {
    const number = (label, field) => {
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
    name.setAttribute("aria-label", "name");
    name.addEventListener("change", () => {
      if (!/^[A-Za-z0-9_-]{1,40}$/.test(name.value)) return toast("A name is made of letters, digits, - and _", "bad"), this.refresh();
      this.shapes.change(() => (shape.name = name.value));
      this.refresh();
    });
    const numbers = shape.kind === "search" ? [number("flown at", "ceiling")] : [...(shape.kind === "obstacle" ? [number("radius", "radius")] : []), number("floor", "floor"), number("ceiling", "ceiling")];
    const row = make("li", this.editing === shape.id ? "editing" : "", "", make("div", "shape-head", "", make("b", "", KIND_WORD[shape.kind]), name), make("div", "shape-numbers", "", ...numbers), make("div", "orders", "", ...this.acts(shape)));
    row.addEventListener("focusin", () => {
      if (this.editing === shape.id) return;
      this.editing = shape.id;
      this.layer.clearLayers();
      for (const each of this.shapes.all) this.drawShape(each);
    });
    return row;
  }

  /** @param {Shape} shape */
  acts(shape) {
    const acts = [];
    if (!READ_ONLY && shape.kind === "search") acts.push(makeButton("Search it…", "small safe", () => this.search(shape), "split between the selected by the planner; shown before it is flown"));
    if (!READ_ONLY && shape.kind !== "search") acts.push(makeButton("Give to the planner…", "small safe", () => this.give(shape), "all plans keep clear of it"));
    acts.push(makeButton("Copy command", "small", () => this.copy(shape), "the line that does the same"));
    if (shape.kind === "geofence") acts.push(makeButton("Save .toml", "small", () => saveFile(`${shape.name}.toml`, fenceTableOf(shape)), "the [geofence] table of a fleet file"));
    acts.push(makeButton("Delete", "small", () => (this.shapes.remove(shape), this.refresh())));
    return acts;
  }

  get origin() {
    if (!this.store.origin) toast("The fleet's origin is not known: no vehicle says where it is about it", "bad", 12000);
    return this.store.origin;
  }

  async search(shape) {
    if (!this.origin) return;
    const vehicles = this.store.chosen.map((vehicle) => vehicle.name);
    if (!vehicles.length) return toast("Select who is to search it", "bad");
    const polygon = /** @type {any} */ (obstacleOf(shape, this.origin).what).polygon;
    await planFirst({ kind: "search", vehicles, polygon, height: shape.ceiling }, this.plans);
  }

  async give(shape) {
    if (!this.origin) return;
    const text = shape.kind === "geofence" ? "Every plan stays inside of it from now on; it takes the place of the one before." : "Every plan keeps clear of it from now on. What is flown is checked against it.";
    if (await confirmed(`Give ${KIND_WORD[shape.kind]} ${shape.name} to the planner?`, text, "Give")) await askPlanner("obstacle", { obstacle: obstacleOf(shape, this.origin) });
    setTimeout(() => this.refresh(), 1500); // by then the planner says what it keeps clear of
  }

  async copy(shape) {
    if (!this.origin) return;
    const line = commandOf(shape, this.origin, this.store.chosen.map((vehicle) => vehicle.name));
    try {
      await navigator.clipboard.writeText(line);
      toast(`Copied: ${line}`, "good");
    } catch (error) {
      toast(line, "", 30000); // no clipboard without TLS or beyond this computer: to be copied by hand
    }
  }
}
