"use strict";
// The table of all vehicles: those in trouble first, filtered by words; a click selects. And the counts, which select, too.

const SORT_MS = 1000;

class FleetTable {
  /** @param {Store} store */
  constructor(store) {
    this.store = store;
    this.body = document.querySelector("#table tbody");
    /** @type {Map<string, any>} */
    this.rows = new Map();
    this.sortedAt = 0;
    this.held = false;
    this.last = "";
    const area = byId("table-scroll");
    area.addEventListener("pointerenter", () => (this.held = true)); // nobody's row moves away under a finger
    area.addEventListener("pointerleave", () => (this.held = false));
    byId("select-all").addEventListener("click", () => store.select(this.shown.map((vehicle) => vehicle.id)));
    byId("select-none").addEventListener("click", () => store.select([]));
    byId("save-group").addEventListener("click", () => this.saveGroup());
    this.counts = new Map();
    this.buildCounts();
    this.groupsDrawn = "";
  }

  /** Those that the filter lets through. */
  get shown() {
    const words = byId("filter").value.toLowerCase().split(/\s+/).filter(Boolean);
    return this.store.all.filter((vehicle) => {
      const text = this.textOf(vehicle);
      return words.every((word) => text.includes(word));
    });
  }

  textOf(vehicle) {
    const s = vehicle.state;
    return [vehicle.name, vehicle.fleet, s.kind, s.autopilot, s.mode, s.armed ? "armed" : "disarmed", vehicle.doing, LEVEL_WORD[vehicle.level], ...vehicle.troubles.map((each) => each.text)].join(" ").toLowerCase();
  }

  async saveGroup() {
    const field = { label: "Name of the group", value: "", type: /** @type {"text"} */ ("text") };
    const names = this.store.chosen.map((vehicle) => vehicle.name);
    const name = await confirmed(`Save ${names.length} vehicles as a group`, few(names, 12), "Save", field);
    if (name) this.store.saveGroup(name);
  }

  buildCounts() {
    const kinds = [...LEVELS.map((level) => ({ name: level, word: LEVEL_WORD[level], fits: (vehicle) => vehicle.level === level })), { name: "armed", word: "armed", fits: (vehicle) => vehicle.state.armed === true }];
    for (const kind of kinds) {
      const button = makeButton("", `chip ${kind.name}`, () => this.store.select(this.store.all.filter(kind.fits).map((vehicle) => vehicle.id)), `select those: ${kind.word}`);
      button.hidden = true;
      this.counts.set(kind, button);
      byId("counts").append(button);
    }
  }

  draw() {
    for (const [kind, button] of this.counts) {
      const count = this.store.all.filter(kind.fits).length;
      button.hidden = count === 0;
      say(button, `${count} ${kind.word}`);
    }
    this.drawGroups();
    const shown = new Set(this.shown);
    for (const vehicle of this.store.all) {
      const row = this.rows.get(vehicle.id) || this.makeRow(vehicle);
      row.element.hidden = !shown.has(vehicle);
      this.drawRow(vehicle, row);
    }
    byId("table").hidden = this.rows.size === 0;
    byId("nobody").hidden = this.rows.size > 0;
    if (Date.now() - this.sortedAt > SORT_MS && !this.held) this.sort();
    const count = this.store.chosen.length;
    say(byId("selected-note"), count ? `${count} of ${this.store.all.length} selected` : "none selected: orders are for all");
    byId("save-group").hidden = count === 0;
  }

  sort() {
    this.sortedAt = Date.now();
    const places = [...this.store.vehicles.keys()];
    const order = [...this.store.all].sort((a, b) => LEVELS.indexOf(a.level) - LEVELS.indexOf(b.level) || places.indexOf(a.id) - places.indexOf(b.id)).map((vehicle) => vehicle.id);
    const text = order.join(" ");
    if (text === this.last) return;
    this.last = text;
    const focused = document.activeElement;
    this.body.append(...order.map((id) => this.rows.get(id).element));
    if (focused instanceof HTMLElement && this.body.contains(focused)) focused.focus();
  }

  makeRow(vehicle) {
    const cells = {};
    const cell = (name, className = "") => (cells[name] = make("td", className));
    const box = make("input");
    box.type = "checkbox";
    box.setAttribute("aria-label", `select ${vehicle.name}`);
    box.addEventListener("click", (event) => event.stopPropagation());
    box.addEventListener("change", () => this.store.toggle(vehicle.id));
    const swatch = make("i", "swatch");
    swatch.style.background = vehicle.colour;
    const name = make("td", "name", "", swatch, make("b", "", vehicle.name), make("span", "muted"));
    const element = make("tr", "", "", make("td", "", "", box), name, cell("mode"), cell("doing"), cell("height", "num"), cell("speed", "num"), cell("battery", "num"), cell("gps"), cell("link"), cell("age", "num"));
    element.tabIndex = 0;
    element.dataset.row = vehicle.name;
    element.addEventListener("click", (event) => this.pick(vehicle, event));
    element.addEventListener("keydown", (event) => this.key(vehicle, event));
    this.body.append(element);
    const row = { element, cells, box, swatch, kind: name.lastChild };
    this.rows.set(vehicle.id, row);
    return row;
  }

  /** A click means this one alone; with ctrl one more or less; with shift all from the last one to this. */
  pick(vehicle, event) {
    if (event.ctrlKey || event.metaKey) this.store.toggle(vehicle.id);
    else if (event.shiftKey && this.from) {
      const ids = [...this.body.children].filter((row) => !(/** @type {HTMLElement} */ (row).hidden)).map((row) => [...this.rows].find((each) => each[1].element === row)[0]);
      const [a, b] = [ids.indexOf(this.from), ids.indexOf(vehicle.id)].sort((x, y) => x - y);
      this.store.select(ids.slice(Math.max(a, 0), b + 1));
      return;
    } else this.store.select([vehicle.id]);
    this.from = vehicle.id;
  }

  key(vehicle, event) {
    const step = { ArrowDown: "nextElementSibling", ArrowUp: "previousElementSibling" }[event.key];
    if (step) {
      let next = event.currentTarget[step];
      while (next && next.hidden) next = next[step];
      if (next) next.focus();
    } else if (event.key === "Enter") this.store.select([vehicle.id]);
    else if (event.key === " ") this.store.toggle(vehicle.id);
    else return;
    event.preventDefault();
  }

  drawRow(vehicle, row) {
    const { element, cells } = row;
    const selected = this.store.selected.has(vehicle.id);
    element.classList.toggle("selected", selected);
    mark(element, "aria-selected", String(selected));
    row.box.checked = selected;
    row.swatch.style.background = vehicle.colour;
    try {
      const s = vehicle.state;
      const level = vehicle.level;
      for (const each of LEVELS) element.classList.toggle(each, each === level);
      element.classList.toggle("stale", vehicle.stale);
      mark(element, "title", vehicle.troubles.map((each) => each.text).join("\n"));
      say(row.kind, s.kind || "");
      say(cells.mode, `${s.mode || "–"}${s.armed ? "" : s.armed === false ? " · disarmed" : " · armed?"}`);
      say(cells.doing, [vehicle.troubles.length ? vehicle.troubles[0].text : "", vehicle.doing].filter(Boolean).join(" · ") || "–");
      say(cells.height, shown(vehicle.height, 1, " m"));
      say(cells.speed, shown(vehicle.speed, 1));
      const battery = s.battery || {};
      say(cells.battery, battery.remaining === null || battery.remaining === undefined ? shown(battery.voltage, 1, " V") : `${Math.round(battery.remaining * 100)} %`);
      say(cells.gps, s.gps ? `${s.gps.fix.replace("_FIXED", "").replace("_FIX", "").replace(/_/g, " ")} ${s.gps.satellites ?? ""}` : "–");
      say(cells.link, this.linkOf(vehicle));
    } catch (error) {
      say(cells.doing, "what it says is not understood");
    }
    say(cells.age, vehicle.stale ? span(vehicle.age) : `${vehicle.age.toFixed(1)} s`);
  }

  /** Its weakest hop, or how far it is. */
  linkOf(vehicle) {
    const network = vehicle.report && vehicle.report.network;
    if (network && network.weakest && network.weakest.grade !== "good") return `${network.weakest.grade}: ${network.weakest.ends.join("–")}`;
    const trip = network && network.rtt !== null ? `${Math.round(network.rtt * 1000)} ms` : "";
    return trip || (vehicle.state.link_loss ? `${Math.round(vehicle.state.link_loss * 100)} % lost` : "–");
  }

  drawGroups() {
    const text = JSON.stringify(this.store.groups);
    if (text === this.groupsDrawn) return;
    this.groupsDrawn = text;
    byId("groups").replaceChildren(
      ...Object.entries(this.store.groups).map(([name, ids]) => {
        const drop = makeButton("×", "plain", () => this.store.dropGroup(name), `forget the group ${name}`);
        return make("span", "group", "", makeButton(name, "chip", () => this.store.select(ids), `select ${few(ids.map((id) => id.split("/")[1]), 12)}`), drop);
      }),
    );
  }
}
