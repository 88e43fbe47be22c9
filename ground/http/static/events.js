// What happened, the newest first.

import { byId, make, say } from "./dom.js";

const SEVERE = new Set(["emergency", "alert", "critical", "error"]);

export class Events {
  /** @param {import("./store.js").Store} store */
  constructor(store) {
    this.store = store;
    this.drawn = 0;
    this.of = store.events; // others where the recording is played from elsewhere
  }

  draw() {
    if (this.store.eventCount === this.drawn && this.store.events === this.of) return;
    [this.drawn, this.of] = [this.store.eventCount, this.store.events];
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
