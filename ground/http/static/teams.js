// Formation and follow for the selected: entered here, placed by a click, shown by the planner before they are flown.

import { byId, make, makeButton, toast } from "./dom.js";
import { toNed } from "./geo.js";
import { planFirst } from "./planner.js";
import { READ_ONLY } from "./settings.js";
import { few, t } from "./words.js";

/** By the planner's names. @type {Record<string, import("./words.js").TextKey>} */
const SHAPES = { line: "teams.line", vee: "teams.vee", column: "teams.column", circle: "teams.circle", grid: "teams.grid" };

export class Teams {
  /** @param {import("./store.js").Store} store @param {import("./map.js").FleetMap} view @param {import("./planlayer.js").PlanLayer} plans */
  constructor(store, view, plans) {
    this.store = store;
    this.view = view;
    this.plans = plans;
    this.leader = make("select");
    this.leader.setAttribute("aria-label", t("teams.leader"));
    if (READ_ONLY) return;
    this.shape = make("select");
    this.shape.append(...Object.entries(SHAPES).map(([value, key]) => Object.assign(make("option", "", t(key)), { value })));
    this.shape.setAttribute("aria-label", t("teams.shape"));
    const number = (/** @type {string} */ value) => Object.assign(make("input", "survey-field"), { type: "number", step: "any", value });
    this.spacing = number("8");
    this.height = number("20");
    this.heading = number("0");
    this.behind = number("10");
    this.above = number("8");
    const labelled = (/** @type {import("./words.js").TextKey} */ key, /** @type {HTMLElement} */ input) => make("label", "", "", `${t(key)} `, input);
    const form = (/** @type {string} */ id, /** @type {import("./words.js").TextKey} */ key, /** @type {HTMLElement[]} */ ...children) => {
      const made = make("details", "", "", make("summary", "", t(key)), make("div", "shape-numbers", "", ...children));
      made.id = id;
      return made;
    };
    const place = makeButton(t("teams.place"), "small safe", () => this.place(), t("draw.fly.title"));
    place.dataset.tool = "formation";
    const follow = makeButton(t("teams.follow"), "small safe", () => this.follow(), t("draw.fly.title"));
    byId("goals").append(
      form("formation", "teams.formation", labelled("teams.shape", this.shape), labelled("teams.spacing", this.spacing), labelled("teams.height", this.height), labelled("teams.heading", this.heading), place),
      form("follow-form", "teams.following", labelled("teams.leader", this.leader), labelled("teams.behind", this.behind), labelled("teams.above", this.above), follow),
    );
  }

  draw() {
    const names = this.store.all.filter((vehicle) => !this.store.selected.has(vehicle.id)).map((vehicle) => vehicle.name);
    if (names.join(" ") === [...this.leader.options].map((each) => each.value).join(" ")) return;
    const before = this.leader.value;
    this.leader.replaceChildren(...names.map((name) => make("option", "", name)));
    if (names.includes(before)) this.leader.value = before;
  }

  /** Who is meant, where a planner is there and can tell places; else it says why not. @returns {string[]} */
  meant() {
    const names = this.store.chosen.map((vehicle) => vehicle.name);
    if (!names.length) toast(t("teams.who"), "bad");
    else if (!this.store.planner) toast(t("goals.no-planner"), "bad", 12000);
    else if (!this.store.origin) toast(t("draw.no-origin"), "bad", 12000);
    else return names;
    return [];
  }

  place() {
    if (this.view.tool && this.view.tool.name === "formation") return this.view.end();
    const vehicles = this.meant();
    const [spacing, height, heading] = [this.spacing, this.height, this.heading].map((input) => Number(input.value));
    if (!vehicles.length) return;
    if (!(spacing > 0 && height > 0 && Number.isFinite(heading))) return toast(t("teams.numbers"), "bad");
    this.view.begin(t("teams.tool", { who: few(vehicles, 6) }), {
      name: "formation",
      click: (where) => {
        this.view.end();
        if (!this.store.origin) return;
        const at = [...toNed(this.store.origin, where), -height];
        planFirst({ kind: "formation", vehicles, shape: this.shape.value, at, spacing, heading: (heading * Math.PI) / 180 }, this.plans);
      },
    });
  }

  async follow() {
    const vehicles = this.meant();
    const [behind, above, spacing] = [this.behind, this.above, this.spacing].map((input) => Number(input.value));
    if (!vehicles.length) return;
    if (![behind, above].every(Number.isFinite) || !(spacing > 0) || !this.leader.value) return toast(t("teams.numbers"), "bad");
    const offsets = vehicles.map((_, index) => [-behind, (index - (vehicles.length - 1) / 2) * spacing, -above]);
    await planFirst({ kind: "follow", vehicles, leader: this.leader.value, offsets }, this.plans);
  }
}
