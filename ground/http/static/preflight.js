// What hinders each vehicle from taking off: the autopilot's own words, and what the rules call bad.

import { byId, make, makeButton, say } from "./dom.js";
import { t } from "./words.js";

export class Preflight {
  /** @param {import("./store.js").Store} store */
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
        const airborne = vehicle.state.armed ? (vehicle.state.landed === false ? t("preflight.airborne") : t("armed")) : "";
        return { id: vehicle.id, name: vehicle.name, reasons: vehicle.hindrances, airborne };
      } catch (error) {
        return { id: vehicle.id, name: vehicle.name, reasons: [t("vehicle.garbled")], airborne: "" };
      }
    });
    const hindered = rows.filter((row) => row.reasons.length);
    say(byId("preflight-count"), hindered.length ? String(hindered.length) : "");
    const state = JSON.stringify([rows, this.store.selected.size]);
    if (state === this.drawn) return;
    this.drawn = state;
    const scope = this.store.selected.size ? t("selected") : t("all");
    const words = hindered.length ? t("preflight.hindered", { count: hindered.length, all: rows.length, scope }) : t("preflight.ready", { all: rows.length, scope });
    say(this.head, rows.length ? words : t("preflight.nobody"));
    this.list.replaceChildren(
      ...[...rows].sort((a, b) => b.reasons.length - a.reasons.length).map((row) =>
        make("li", row.reasons.length ? "no" : "go", "", make("b", "", row.reasons.length ? "✗" : "✓"), makeButton(row.name, "plain", () => this.store.select([row.id])), make("span", "", row.reasons.join("; ") || row.airborne || t("preflight.go"))),
      ),
    );
  }
}
