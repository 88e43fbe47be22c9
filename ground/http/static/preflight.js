"use strict";
// What hinders each vehicle from taking off: the autopilot's own words, and what the rules call bad.

class Preflight {
  /** @param {Store} store */
  constructor(store) {
    this.store = store;
    this.head = make("p", "muted");
    this.list = make("ol", "preflight");
    byId("preflight").append(this.head, this.list);
    this.drawn = "";
  }

  draw() {
    const whom = this.store.selected.size ? this.store.chosen : this.store.all;
    const rows = whom.map((vehicle) => {
      try {
        const airborne = vehicle.state.armed ? (vehicle.state.landed === false ? "in the air" : "armed") : "";
        return { id: vehicle.id, name: vehicle.name, reasons: vehicle.hindrances, airborne };
      } catch (error) {
        return { id: vehicle.id, name: vehicle.name, reasons: ["what it says is not understood"], airborne: "" };
      }
    });
    const hindered = rows.filter((row) => row.reasons.length);
    say(byId("preflight-count"), hindered.length ? String(hindered.length) : "");
    const state = JSON.stringify([rows, this.store.selected.size]);
    if (state === this.drawn) return;
    this.drawn = state;
    const scope = this.store.selected.size ? "selected" : "all";
    say(this.head, !rows.length ? "Nobody is there." : hindered.length ? `${hindered.length} of ${rows.length} ${scope} cannot go; several take off only when nothing hinders any of them.` : `Nothing hinders the ${rows.length} ${scope}.`);
    this.list.replaceChildren(
      ...[...rows].sort((a, b) => b.reasons.length - a.reasons.length).map((row) =>
        make("li", row.reasons.length ? "no" : "go", "", make("b", "", row.reasons.length ? "✗" : "✓"), makeButton(row.name, "plain", () => this.store.select([row.id])), make("span", "", row.reasons.join("; ") || row.airborne || "ready")),
      ),
    );
  }
}
