// What the planner flies: each goal with its progress, how long it takes yet, and a stop.

import { byId, make, makeButton, mark, meant, say } from "./dom.js";
import { armTwice } from "./orders.js";
import { askPlanner } from "./planner.js";
import { READ_ONLY } from "./settings.js";
import { few, metres, span, t } from "./words.js";

/** @typedef {import("./types.js").GoalEntry} GoalEntry */

export class Goals {
  /** @param {import("./store.js").Store} store */
  constructor(store) {
    this.store = store;
    this.list = make("ol", "goals");
    this.head = make("p", "muted");
    byId("goals").append(this.head, this.list);
    this.drawn = "";
  }

  draw() {
    const open = this.store.openGoals;
    const book = this.store.book;
    const who = book ? book.planner : t("planner.any");
    const head = !this.store.planner ? t("goals.no-planner") : open.length ? t("goals.planner", { who }) : t("goals.none", { who });
    say(this.head, head);
    say(byId("goal-count"), open.length ? String(open.length) : "");
    const ended = book ? book.goals.filter((entry) => !open.includes(entry)).slice(-3).reverse() : [];
    // Figures are put into the row that is there: a button whose second press is waited for stays.
    const state = JSON.stringify([open.map(({ progress, clearance, ...row }) => row), ended]);
    if (state !== this.drawn) {
      this.drawn = state;
      this.list.replaceChildren(...open.map((entry) => this.row(entry)), ...ended.map((entry) => make("li", `ended ${entry.state}`, "", make("b", "", entry.goal.kind), make("span", "", few(entry.goal.vehicles)), make("span", "muted", stateOf(entry)))));
    }
    for (const element of this.list.querySelectorAll("[data-goal]")) this.drawLeft(/** @type {HTMLElement} */ (element));
  }

  /** @param {GoalEntry} entry */
  row(entry) {
    const bar = make("progress");
    bar.max = 1;
    const left = make("span", "muted");
    left.dataset.goal = entry.id;
    const row = make("li", entry.state, "", make("b", "", entry.goal.kind), make("span", "", few(entry.goal.vehicles)), make("span", "muted", stateOf(entry)), bar, left);
    if (READ_ONLY) return row;
    const paused = entry.state === "paused";
    const appeared = performance.now();
    const toggle = makeButton(paused ? t("resume") : t("pause"), "small safe", (press) => {
      if (!paused) askPlanner("pause", { goal: entry.id });
      else if (meant(press, appeared)) askPlanner("resume", { goal: entry.id }); // else it was the second click of a pause
    });
    const stop = makeButton(t("goals.stop"), "small safe", null, t("goals.stop.title"));
    armTwice(stop, () => askPlanner("cancel", { goal: entry.id }));
    row.append(make("div", "orders", "", toggle, stop));
    return row;
  }

  /** @param {HTMLElement} element */
  drawLeft(element) {
    const entry = this.store.openGoals.find((each) => each.id === element.dataset.goal);
    const bar = element.previousElementSibling;
    if (entry && bar instanceof HTMLProgressElement) {
      bar.value = entry.progress;
      mark(bar, "aria-label", t("goals.progress", { goal: entry.goal.kind, percent: Math.round(entry.progress * 100) }));
    }
    const plan = this.store.plans.get(element.dataset.goal || "");
    const left = plan ? plan.start + plan.makespan - Date.now() / 1000 : null;
    const clear = entry && entry.clearance !== null ? t("goals.clear", { metres: metres(entry.clearance) }) : "";
    const rest = left !== null && left > 0 ? t("goals.left", { span: span(left) }) : "";
    say(element, [`${entry ? Math.round(entry.progress * 100) : 0} %`, rest, clear].filter(Boolean).join(" · "));
  }
}

/** @param {GoalEntry} entry */
const stateOf = (entry) => [entry.state, entry.text].filter(Boolean).join(": ");
