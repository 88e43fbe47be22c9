// The bar of orders: for the selected, or for all where nobody is. It names whom it means before it is pressed.

import { confirmed } from "./ask.js";
import { byId, make, makeButton, meant, say, toast } from "./dom.js";
import { toNed, wayBetween } from "./geo.js";
import { armTwice, askArm, askHeight, order } from "./orders.js";
import { askPlanner, planFirst } from "./planner.js";
import { READ_ONLY } from "./settings.js";
import { showTab } from "./tabs.js";
import { brief, few, metres, t } from "./words.js";

/** @typedef {import("./types.js").Place} Place @typedef {import("./vehicle.js").Vehicle} Vehicle */

export class OrderBar {
  /** @param {import("./store.js").Store} store @param {import("./map.js").FleetMap} view @param {import("./planlayer.js").PlanLayer} plans */
  constructor(store, view, plans) {
    this.store = store;
    this.view = view;
    this.plans = plans;
    const bar = byId("bar");
    const add = (/** @type {string} */ label, /** @type {string} */ className, /** @type {((press: MouseEvent) => void) | null} */ act, /** @type {string} */ title) => {
      const button = makeButton(label, className, act, title);
      bar.append(button);
      return button;
    };
    this.hold = add(t("hold"), "safe", () => order(this.ids, "hold"), t("hold.title"));
    this.pause = add(t("pause"), "safe", (press) => this.pauseOrResume(press), t("pause.title"));
    this.land = add(t("land"), "safe", null, t("land.title"));
    this.rtl = add(t("return"), "safe", null, t("return.title"));
    /** A second press is for whom the first one named: another selection takes it back. */
    this.asked = [armTwice(this.land, () => order(this.ids, "land")), armTwice(this.rtl, () => order(this.ids, "rtl"))];
    this.meant = "";
    this.resumes = false;
    this.resumesAt = 0;
    this.land.dataset.verb = "land";
    this.rtl.dataset.verb = "rtl";
    this.hold.dataset.verb = "hold";
    bar.append(make("span", "divider"));
    /** What moves or arms: for the selected only. */
    this.moving = [
      add(t("arm.ask"), "", () => this.arm(), ""),
      add(t("takeoff.ask"), "", () => this.takeoff(), ""),
      add(t("mode.ask"), "", () => this.mode(), ""),
      add(t("go.ask"), "", () => this.goHere(), t("go.title")),
    ];
    this.moving[3].dataset.tool = "go";
  }

  /** @returns {string[]} whom a press means now */
  get ids() {
    return this.store.selected.size ? [...this.store.selected] : ["*"];
  }

  /** Also those of a group that were not heard: they are ordered, too. */
  get names() {
    return [...this.store.selected].map((id) => id.split("/")[1]);
  }

  /** @param {number} all how many there are */
  whom(all) {
    if (!this.store.selected.size) return t("whom.all", { all });
    const names = few(this.names, 6);
    return all > 1 ? t("whom", { names, count: this.names.length, all }) : names;
  }

  draw() {
    const all = this.store.all.length;
    const live = this.store.connection === "live";
    byId("everybody").hidden = READ_ONLY || all === 0;
    const meant = this.ids.join(" ");
    if (meant !== this.meant) {
      for (const rest of this.asked) rest();
      if (this.view.tool && this.view.tool.name === "go") this.view.end(); // its words name others
    }
    this.meant = meant;
    say(byId("whom-names"), this.whom(all));
    const count = this.store.selected.size;
    const who = count === 0 ? t("all") : count === 1 ? brief(this.names[0] || "") : String(count);
    /** @type {[HTMLButtonElement, string][]} */
    const labels = [[this.hold, t("hold.who", { who })], [this.land, t("land.who", { who })], [this.rtl, t("return.who", { who })]];
    for (const [button, label] of labels) if (!button.classList.contains("asking")) say(button, label);
    for (const button of this.moving) button.disabled = !live || count === 0;
    const flying = this.goalsOf();
    const paused = flying.length > 0 && flying.every((entry) => entry.state === "paused");
    if (paused && !this.resumes) this.resumesAt = performance.now();
    this.resumes = paused;
    say(this.pause, paused ? t("resume") : t("pause"));
    this.pause.disabled = !live || !this.store.planner || flying.length === 0;
    this.pause.title = this.store.planner ? t("pause.title") : t("pause.none");
  }

  /** Open goals of whom is meant. */
  goalsOf() {
    const names = new Set(this.names);
    return this.store.openGoals.filter((entry) => !names.size || entry.goal.vehicles.some((name) => names.has(name)));
  }

  /** A pause is one press; what follows it at once, as a double click does, resumes nothing. @param {MouseEvent} press */
  async pauseOrResume(press) {
    const goals = this.goalsOf();
    const verb = goals.every((entry) => entry.state === "paused") ? "resume" : "pause";
    if (verb === "resume" && !(this.resumes && meant(press, this.resumesAt))) return;
    const whole = !this.store.selected.size;
    for (const goal of whole ? [""] : goals.map((entry) => entry.id)) await askPlanner(verb, { goal });
  }

  async arm() {
    const chosen = this.store.chosen;
    const armed = chosen.length > 0 && chosen.every((vehicle) => vehicle.state.armed);
    await askArm(this.ids, this.names, armed);
  }

  /** Several go only where nothing hinders one of them, and by the planner, in an order in which nobody meets, where there is one. */
  async takeoff() {
    const chosen = this.store.chosen;
    const names = this.names;
    const hindered = chosen.filter((vehicle) => vehicle.hindrances.length);
    if (chosen.length > 1 && hindered.length) {
      showTab("preflight");
      toast(t("takeoff.hindered", { count: names.length, reasons: hindered.map((vehicle) => `${vehicle.name}: ${vehicle.hindrances[0]}`).join("; ") }), "bad", 15000);
      return;
    }
    const planned = this.store.planner && chosen.length > 1;
    const ids = this.ids;
    const height = await askHeight(names, planned ? t("takeoff.planned") : t("takeoff.straight"));
    if (height === null) return;
    if (planned) await askPlanner("submit", { goal: { kind: "takeoff", vehicles: names, height } });
    else await order(ids, "takeoff", { alt_rel: height });
  }

  async mode() {
    const ids = this.ids;
    const options = [...new Set(this.store.all.flatMap(({ state }) => (typeof state.mode === "string" ? [state.mode] : [])))];
    const field = { label: t("mode.field"), value: "", type: /** @type {"text"} */ ("text"), options };
    const mode = await confirmed(t("mode.title", { who: few(this.names, 8) }), t("mode.text"), t("mode.yes"), field);
    if (mode) await order(ids, "set_mode", { mode });
  }

  goHere() {
    if (this.view.tool && this.view.tool.name === "go") return this.view.end();
    this.view.begin(t("go.tool", { who: few(this.names, 6), count: this.names.length }), {
      name: "go",
      click: (place) => {
        this.view.end();
        this.go(place);
      },
    });
  }

  /** @param {Place} place */
  async go(place) {
    const chosen = this.store.chosen.filter((vehicle) => vehicle.place);
    if (this.store.planner && this.store.origin) return this.goPlanned(chosen, this.store.origin, place);
    if (chosen.length !== 1) return toast(t("go.several"), "bad", 12000);
    const [vehicle] = chosen;
    const way = wayBetween(/** @type {Place} */ (vehicle.place), place);
    const text = t("go.text", { metres: metres(way.distance), bearing: Math.round(way.bearing) % 360 });
    const field = { label: t("height.field"), value: Math.max(1, Math.round(vehicle.height || 10)) };
    const height = await confirmed(t("go.send", { who: vehicle.name }), text, t("go"), field);
    if (!(height > 0)) return;
    const where = this.store.nowhere && this.store.origin ? { frame: "ned", pos: [...toNed(this.store.origin, place), -height] } : { frame: "global", lat_deg: place.lat, lon_deg: place.lon, alt_rel: height };
    await order([vehicle.id], "goto", where);
  }

  /**
   * They keep their places about their middle, and their heights.
   * @param {Vehicle[]} chosen @param {Place} origin @param {Place} place
   */
  async goPlanned(chosen, origin, place) {
    const flying = chosen.flatMap(({ name, state }) => (state.local ? [{ name, local: state.local }] : []));
    if (!flying.length) return toast(t("go.unknown"), "bad", 12000);
    const middle = [0, 1].map((i) => flying.reduce((sum, each) => sum + each.local[i], 0) / flying.length);
    const [north, east] = toNed(origin, place);
    const to = flying.map(({ local }) => [north + local[0] - middle[0], east + local[1] - middle[1], local[2]]);
    await planFirst({ kind: "goto", vehicles: flying.map((each) => each.name), to, labelled: true }, this.plans);
  }
}
