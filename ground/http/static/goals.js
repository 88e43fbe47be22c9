"use strict";
// What the planner flies: each goal with its progress, how long it takes yet, and a stop.

class Goals {
  /** @param {Store} store */
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
    const head = this.store.planner ? `${book ? book.planner : "a planner"} is in charge${open.length ? "" : "; no open goals"}` : "No planner is in charge: 'zmav swarm planner' starts one.";
    say(this.head, head);
    say(byId("goal-count"), open.length ? String(open.length) : "");
    const ended = book ? book.goals.filter((entry) => !open.includes(entry)).slice(-3).reverse() : [];
    const state = JSON.stringify([open, ended]);
    if (state !== this.drawn) {
      this.drawn = state;
      this.list.replaceChildren(...open.map((entry) => this.row(entry)), ...ended.map((entry) => make("li", `ended ${entry.state}`, "", make("b", "", entry.goal.kind), make("span", "", few(entry.goal.vehicles)), make("span", "muted", `${entry.state}${entry.text ? `: ${entry.text}` : ""}`))));
    }
    for (const element of this.list.querySelectorAll("[data-goal]")) this.drawLeft(/** @type {HTMLElement} */ (element));
  }

  row(entry) {
    const bar = make("progress");
    bar.max = 1;
    bar.value = entry.progress;
    bar.setAttribute("aria-label", `${entry.goal.kind}: ${Math.round(entry.progress * 100)} %`);
    const left = make("span", "muted");
    left.dataset.goal = entry.id;
    const row = make("li", entry.state, "", make("b", "", entry.goal.kind), make("span", "", few(entry.goal.vehicles)), make("span", "muted", `${entry.state}${entry.text ? `: ${entry.text}` : ""}`), bar, left);
    if (READ_ONLY) return row;
    const paused = entry.state === "paused";
    const toggle = makeButton(paused ? "Go on" : "Pause", "small safe", () => askPlanner(paused ? "resume" : "pause", { goal: entry.id }));
    const stop = makeButton("Stop", "small safe", null, "its vehicles come to rest, and it is dropped");
    armTwice(stop, () => askPlanner("cancel", { goal: entry.id }));
    row.append(make("div", "orders", "", toggle, stop));
    return row;
  }

  drawLeft(element) {
    const entry = this.store.openGoals.find((each) => each.id === element.dataset.goal);
    const plan = this.store.plans.get(element.dataset.goal);
    const left = plan ? plan.start + plan.makespan - Date.now() / 1000 : null;
    const clear = entry && entry.clearance !== null ? ` · ${metres(entry.clearance)} clear` : "";
    say(element, `${entry ? Math.round(entry.progress * 100) : 0} %${left !== null && left > 0 ? ` · ${span(left)} of this plan left` : ""}${clear}`);
  }
}
