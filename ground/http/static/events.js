// What happened, the newest first.

import { byId, make, say } from "./dom.js";

const SEVERE = new Set(["emergency", "alert", "critical", "error"]);

export class Events {
  /** @param {import("./store.js").Store} store */
  constructor(store) {
    this.store = store;
    this.drawn = 0;
  }

  draw() {
    if (this.store.eventCount === this.drawn) return;
    this.drawn = this.store.eventCount;
    say(byId("event-count"), String(this.drawn));
    byId("events").replaceChildren(
      ...this.store.events.map((event) => {
        const when = new Date(event.t * 1000).toLocaleTimeString([], { hour12: false });
        const kind = SEVERE.has(event.severity) ? "bad" : event.severity === "warning" ? "warn" : "";
        return make("li", kind, "", make("time", "", when), make("b", "", event.name), make("span", "", event.text));
      }),
    );
  }
}
