// One list of what is not well, the worst first, until it is gone; a person says that he has seen it. The rules are the
// gateway's, which has them from zmav/doctor.

import { byId, make, makeButton, say } from "./dom.js";
import { LEVEL_WORD, LEVELS, t } from "./words.js";

const SETTLED_MS = 5000; // after that a page that was loaded again has heard what is wrong

/** @typedef {{key: string, who: string, id: string, alarm: import("./types.js").Alarm}} Standing */

export class Alarms {
  /** @param {import("./store.js").Store} store */
  constructor(store) {
    this.store = store;
    this.since = Date.now();
    /** @type {Map<string, {element: HTMLElement, level: HTMLElement, words: HTMLElement, seen: HTMLButtonElement}>} */
    this.rows = new Map();
    this.list = make("ol", "alarms");
    this.none = make("p", "muted", t("alarms.none"));
    byId("alarms").append(this.none, this.list);
  }

  /** @returns {Standing[]} */
  get all() {
    const found = this.store.all.flatMap((vehicle) => vehicle.troubles.map((alarm) => ({ key: `${vehicle.id} ${alarm.rule}`, who: vehicle.name, id: vehicle.id, alarm })));
    if (this.store.book && this.store.openGoals.length && !this.store.planner && this.store.connection === "live")
      found.push({ key: "planner", who: t("planner"), id: "", alarm: { rule: "planner", level: "bad", text: t("planner.lost", { who: this.store.book.planner }), advice: t("planner.lost.advice") } });
    return found;
  }

  draw() {
    const all = this.all;
    const now = new Set(all.map((each) => each.key));
    const settled = Date.now() - this.since > SETTLED_MS && this.store.connection === "live";
    this.store.keepSeen((key) => now.has(key) || !(settled || this.rows.has(key)));
    for (const [key, row] of this.rows) {
      if (now.has(key)) continue;
      row.element.remove();
      this.rows.delete(key);
    }
    const rank = (/** @type {Standing} */ { key, alarm }) => LEVELS.indexOf(alarm.level) + (this.store.seen.has(key) ? 10 : 0);
    all.sort((a, b) => rank(a) - rank(b));
    const order = all.map((each) => this.drawRow(each));
    if (order.some((element, index) => this.list.children[index] !== element)) this.list.append(...order);
    this.none.hidden = all.length > 0;
    const open = all.filter((each) => !this.store.seen.has(each.key) && each.alarm.level !== "note");
    const count = byId("alarm-count");
    say(count, open.length ? String(open.length) : "");
    count.className = open.length ? `pill ${open.some((each) => each.alarm.level === "bad") ? "hot" : "warned"}` : "";
  }

  /** @param {Standing} standing @returns {HTMLElement} */
  drawRow({ key, who, id, alarm }) {
    let row = this.rows.get(key);
    if (!row) {
      const words = make("span");
      const whom = makeButton(who, "plain", () => id && this.store.select([id]), t("select.one", { who }));
      const seen = makeButton(t("alarms.seen"), "small", () => this.store.see(key), t("alarms.seen.title"));
      const level = make("b", "level", LEVEL_WORD[alarm.level]);
      const element = make("li", "", "", level, make("div", "", "", whom, words, make("p", "muted", alarm.advice)), seen);
      row = { element, level, words, seen };
      this.rows.set(key, row);
      this.list.append(element);
    }
    const known = this.store.seen.has(key);
    row.element.className = `${alarm.level}${known ? " seen" : ""}`;
    say(row.level, LEVEL_WORD[alarm.level]);
    say(row.words, alarm.text);
    row.seen.hidden = known || alarm.level === "note";
    return row.element;
  }
}
