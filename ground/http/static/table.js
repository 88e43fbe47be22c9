// The table of all vehicles: those in trouble first, filtered by words; a click selects. And the counts, which select, too.

import { confirmed } from "./ask.js";
import { byId, make, makeButton, mark, say } from "./dom.js";
import { accuracy, few, LEVEL_WORD, LEVELS, shown, span, t } from "./words.js";

/**
 * @typedef {import("./vehicle.js").Vehicle} Vehicle
 * @typedef {{element: HTMLElement, cells: Record<string, HTMLElement>, box: HTMLInputElement, swatch: HTMLElement, name: HTMLElement, kind: HTMLElement}} Row
 * @typedef {{name: string, word: string, fits: (vehicle: Vehicle) => boolean}} Kind what a count counts
 */

const SORT_MS = 1000;

export class FleetTable {
  /** @param {import("./store.js").Store} store */
  constructor(store) {
    this.store = store;
    this.body = byId("rows");
    /** @type {Map<string, Row>} */
    this.rows = new Map();
    this.sortedAt = 0;
    /** @type {string | null} id: where a range begins */
    this.from = null;
    this.held = false;
    this.last = "";
    const area = byId("table-scroll");
    area.addEventListener("pointerenter", () => (this.held = true)); // nobody's row moves away under a finger
    area.addEventListener("pointerleave", () => (this.held = false));
    byId("select-all").addEventListener("click", () => store.select(this.shown.map((vehicle) => vehicle.id)));
    byId("select-none").addEventListener("click", () => store.select([]));
    byId("save-group").addEventListener("click", () => this.saveGroup());
    /** @type {Map<Kind, HTMLButtonElement>} */
    this.counts = new Map();
    this.buildCounts();
    this.groupsDrawn = "";
  }

  /** Those that the filter lets through. */
  get shown() {
    /** @type {string[]} */
    const words = byId("filter").value.toLowerCase().split(/\s+/).filter(Boolean);
    return this.store.all.filter((vehicle) => {
      const text = this.textOf(vehicle);
      return words.every((word) => text.includes(word));
    });
  }

  /** @param {Vehicle} vehicle */
  textOf(vehicle) {
    const s = vehicle.state;
    return [vehicle.name, vehicle.fleet, s.kind, s.autopilot, s.mode, s.armed ? t("armed") : t("disarmed"), vehicle.doing, LEVEL_WORD[vehicle.level], ...vehicle.troubles.map((each) => each.text)].join(" ").toLowerCase();
  }

  async saveGroup() {
    const field = { label: t("group.field"), value: "", type: /** @type {"text"} */ ("text") };
    const names = this.store.chosen.map((vehicle) => vehicle.name);
    const name = await confirmed(t("group.title", { count: names.length }), few(names, 12), t("group.yes"), field);
    if (name) this.store.saveGroup(name);
  }

  buildCounts() {
    /** @type {Kind[]} */
    const levels = LEVELS.map((level) => ({ name: level, word: LEVEL_WORD[level], fits: (vehicle) => vehicle.level === level }));
    /** @type {Kind[]} */
    const kinds = [...levels, { name: "armed", word: t("armed"), fits: (vehicle) => vehicle.state.armed === true }];
    for (const kind of kinds) {
      const button = makeButton("", `chip ${kind.name}`, () => this.store.select(this.store.all.filter(kind.fits).map((vehicle) => vehicle.id)), t("select.those", { word: kind.word }));
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
    say(byId("selected-note"), count ? t("table.selected", { count, all: this.store.all.length }) : t("table.none"));
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
    this.body.append(...order.flatMap((id) => this.rows.get(id)?.element || []));
    if (focused instanceof HTMLElement && this.body.contains(focused)) focused.focus();
  }

  /** @param {Vehicle} vehicle @returns {Row} */
  makeRow(vehicle) {
    /** @type {Record<string, HTMLElement>} */
    const cells = {};
    const cell = (/** @type {string} */ name, className = "") => (cells[name] = make("td", className));
    const box = make("input");
    box.type = "checkbox";
    box.setAttribute("aria-label", t("select.one", { who: vehicle.name }));
    box.addEventListener("click", (/** @type {Event} */ event) => event.stopPropagation());
    box.addEventListener("change", () => this.store.toggle(vehicle.id));
    const swatch = make("i", "swatch");
    swatch.style.background = vehicle.colour;
    const kind = make("span", "muted");
    const name = make("td", "name", "", swatch, make("b", "", vehicle.name), kind);
    const element = make("tr", "", "", make("td", "", "", box), name, cell("mode"), cell("doing"), cell("height", "num"), cell("speed", "num"), cell("battery", "num"), cell("gps"), cell("link"), cell("age", "num"));
    element.tabIndex = 0;
    element.dataset.row = vehicle.name;
    element.addEventListener("click", (/** @type {MouseEvent} */ event) => this.pick(vehicle, event));
    element.addEventListener("keydown", (/** @type {KeyboardEvent} */ event) => this.key(vehicle, event));
    this.body.append(element);
    const row = { element, cells, box, swatch, name, kind };
    this.rows.set(vehicle.id, row);
    return row;
  }

  /** A click means this one alone; with ctrl one more or less; with shift all from the last one to this. @param {Vehicle} vehicle @param {MouseEvent} event */
  pick(vehicle, event) {
    if (event.ctrlKey || event.metaKey) this.store.toggle(vehicle.id);
    else if (event.shiftKey && this.from) {
      const ids = [...this.rows].filter(([, row]) => !row.element.hidden).sort(([, a], [, b]) => a.element.compareDocumentPosition(b.element) & Node.DOCUMENT_POSITION_FOLLOWING ? -1 : 1).map(([id]) => id);
      const [a, b] = [ids.indexOf(this.from), ids.indexOf(vehicle.id)].sort((x, y) => x - y);
      this.store.select(ids.slice(Math.max(a, 0), b + 1));
      return;
    } else this.store.select([vehicle.id]);
    this.from = vehicle.id;
  }

  /** @param {Vehicle} vehicle @param {KeyboardEvent} event */
  key(vehicle, event) {
    if (event.key === "ArrowDown" || event.key === "ArrowUp") {
      const step = event.key === "ArrowDown" ? "nextElementSibling" : "previousElementSibling";
      let next = /** @type {any} */ (event.currentTarget)[step];
      while (next && next.hidden) next = next[step];
      if (next) next.focus();
    } else if (event.key === "Enter") this.store.select([vehicle.id]);
    else if (event.key === " ") this.store.toggle(vehicle.id);
    else return;
    event.preventDefault();
  }

  /** @param {Vehicle} vehicle @param {Row} row */
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
      mark(row.name, "title", [vehicle.name, s.kind].filter(Boolean).join(" · ")); // a long name is cut
      say(cells.mode, [s.mode || "–", s.armed ? "" : s.armed === false ? t("disarmed") : t("armed.unknown")].filter(Boolean).join(" · "));
      say(cells.doing, [vehicle.troubles.length ? vehicle.troubles[0].text : "", vehicle.doing].filter(Boolean).join(" · ") || "–");
      say(cells.height, shown(vehicle.height, 1, " m"));
      say(cells.speed, shown(vehicle.speed, 1));
      const { remaining = null, voltage = null, time_left: left = null } = s.battery || {};
      const charge = remaining === null ? shown(voltage, 1, " V") : `${Math.round(remaining * 100)} %`;
      say(cells.battery, [charge, left === null ? "" : span(left)].filter(Boolean).join(" · "));
      const fix = s.gps ? s.gps.fix.replace("_FIXED", "").replace("_FIX", "").replace(/_/g, " ") : "–";
      say(cells.gps, `${fix} ${accuracy(s.gps) || (s.gps?.satellites ?? "")}`.trim());
      say(cells.link, this.linkOf(vehicle));
    } catch (error) {
      say(cells.doing, t("vehicle.garbled"));
    }
    say(cells.age, vehicle.stale ? span(vehicle.age) : `${vehicle.age.toFixed(1)} s`);
  }

  /** Its weakest hop, or how far it is. @param {Vehicle} vehicle */
  linkOf(vehicle) {
    const network = vehicle.report && vehicle.report.network;
    if (network && network.weakest && network.weakest.grade !== "good") return `${network.weakest.grade}: ${network.weakest.ends.join("–")}`;
    const trip = network && network.rtt != null ? `${Math.round(network.rtt * 1000)} ms` : "";
    return trip || (vehicle.state.link_loss ? t("table.lost", { percent: Math.round(vehicle.state.link_loss * 100) }) : "–");
  }

  drawGroups() {
    const text = JSON.stringify(this.store.groups);
    if (text === this.groupsDrawn) return;
    this.groupsDrawn = text;
    byId("groups").replaceChildren(
      ...Object.entries(this.store.groups).map(([name, ids]) => {
        const drop = makeButton("×", "plain", () => this.store.dropGroup(name), t("group.forget", { name }));
        return make("span", "group", "", makeButton(name, "chip", () => this.store.select(ids), t("select.one", { who: few(ids.map((id) => id.split("/")[1]), 12) })), drop);
      }),
    );
  }
}
