// One card a selected vehicle: what it is and does, how old that is, and its orders.

import { CameraViews } from "./cameras.js";
import { byId, make, makeButton, say } from "./dom.js";
import { armTwice, askArm, askHeight, order } from "./orders.js";
import { READ_ONLY } from "./settings.js";
import { accuracy, corrected, degrees, shown, span, t } from "./words.js";

/** @typedef {import("./types.js").State} State */

const MOST_CARDS = 12;
const SURFACE = new Set(["rover", "boat"]);

class Card {
  /** @param {import("./vehicle.js").Vehicle} vehicle @param {import("./link.js").Link} link @param {import("./map.js").FleetMap} map */
  constructor(vehicle, link, map) {
    this.vehicle = vehicle;
    this.cameras = new CameraViews(vehicle, link, map);
    /** @type {Record<string, any>} */
    this.parts = {};
    this.element = this.build();
  }

  build() {
    const part = (/** @type {string} */ name, /** @type {HTMLElement} */ element) => (this.parts[name] = element);
    const fact = (/** @type {string} */ name, /** @type {string} */ label) => make("div", "fact", "", make("dt", "", label), part(name, make("dd", "", "–")));
    const head = make("div", "card-head", "", make("h2", "", this.vehicle.name), part("what", make("span", "muted")), part("age", make("span", "age")));
    const mode = make("div", "card-mode", "", part("mode", make("span", "mode", "–")), part("armed", make("span", "pill")), part("holder", make("span", "pill info")));
    const battery = make("div", "battery", "", part("fill", make("i")));
    const facts = make("dl", "facts", "", fact("alt", t("height")), fact("speed", t("speed")), fact("heading", t("heading")), fact("battery", t("battery")), fact("left", t("battery.left")), fact("loss", t("loss")), fact("gps", t("gps")), fact("accuracy", t("accuracy")), fact("place", t("position")));
    const card = make("article", "card", "", head, mode, part("note", make("p", "note")), battery, facts, this.cameras.element);
    card.dataset.vehicle = this.vehicle.name;
    if (!READ_ONLY) card.append(this.buttons());
    return card;
  }

  buttons() {
    const hold = makeButton(t("hold"), "safe", () => order([this.vehicle.id], "hold"));
    const land = makeButton(t("land"), "safe", null);
    const rtl = makeButton(t("rtl"), "safe", null);
    armTwice(land, () => order([this.vehicle.id], "land"));
    armTwice(rtl, () => order([this.vehicle.id], "rtl"));
    const arm = makeButton(t("arm.ask"), "", () => askArm([this.vehicle.id], [this.vehicle.name], this.vehicle.state.armed === true));
    const takeoff = makeButton(t("takeoff.ask"), "", () => this.takeoff());
    const orders = make("div", "orders", "", hold, land, rtl, arm, takeoff);
    Object.assign(this.parts, { land, arm, takeoff, orders });
    return orders;
  }

  async takeoff() {
    const height = await askHeight([this.vehicle.name], t("takeoff.straight"));
    if (height !== null) await order([this.vehicle.id], "takeoff", { alt_rel: height });
  }

  /** @param {string} part @param {string} text */
  say(part, text) {
    say(this.parts[part], text);
  }

  /** A state that is not as it should be spoils its own card and no other. */
  drawSafely() {
    try {
      this.draw();
      this.cameras.draw();
    } catch (error) {
      this.element.classList.add("trouble");
      this.parts.note.hidden = false;
      this.say("note", t("vehicle.garbled"));
    }
  }

  draw() {
    const s = this.vehicle.state;
    const alarms = this.vehicle.stale ? this.vehicle.alarms : this.vehicle.troubles;
    const worst = alarms.length ? alarms[0].level : "";
    this.element.classList.toggle("stale", this.vehicle.stale);
    this.element.classList.toggle("trouble", worst === "bad");
    this.element.classList.toggle("armed", Boolean(s.armed));
    this.say("what", [s.kind, s.autopilot, s.sysid == null ? "" : t("card.id", { id: s.sysid })].filter(Boolean).join(" · "));
    this.say("age", t(this.vehicle.stale ? "vehicle.silent" : "ago", { span: span(this.vehicle.age) }));
    this.say("mode", s.mode || "–");
    this.say("armed", s.armed ? t("card.armed") : s.armed === false ? t("disarmed") : t("armed.unknown"));
    this.parts.armed.className = `pill ${s.armed ? "armed" : ""}`;
    this.parts.holder.hidden = !s.lease;
    this.say("holder", s.lease ? t("card.held", { holder: s.lease.holder }) : "");
    this.parts.note.hidden = !alarms.length;
    this.parts.note.title = alarms.map((alarm) => alarm.advice).join("\n");
    this.say("note", alarms.map((alarm) => alarm.text).join(". "));
    this.drawFacts(s);
    if (READ_ONLY) return;
    this.parts.orders.hidden = s.replayed === true;
    this.parts.land.hidden = this.parts.takeoff.hidden = SURFACE.has(s.kind || "");
    this.say("arm", s.armed ? t("disarm.ask") : t("arm.ask"));
  }

  /** @param {State} s */
  drawFacts(s) {
    const v = s.velocity;
    this.say("alt", shown(s.position && s.position.alt_rel, 1, " m"));
    this.say("speed", shown(v && Math.hypot(v[0], v[1]), 1, " m/s"));
    this.say("heading", shown(s.attitude && degrees(s.attitude.yaw), 0, "°"));
    this.say("gps", [s.gps ? `${s.gps.fix.replace(/_/g, " ")} · ${s.gps.satellites ?? "–"}` : "–", corrected(s.corrections)].filter(Boolean).join(" · "));
    this.say("accuracy", accuracy(s.gps) || "–");
    this.say("left", s.battery?.time_left ? span(s.battery.time_left) : "–");
    this.say("loss", shown(s.link_loss === undefined ? null : s.link_loss * 100, 0, " %"));
    this.say("place", s.position ? `${s.position.lat_deg.toFixed(6)}, ${s.position.lon_deg.toFixed(6)}` : "–");
    const left = s.battery?.remaining ?? null;
    const volts = s.battery?.voltage ?? null;
    this.say("battery", [left === null ? "" : `${Math.round(left * 100)} %`, volts === null ? "" : `${volts.toFixed(1)} V`].filter(Boolean).join(" · ") || "–");
    this.parts.fill.style.width = `${Math.max(0, Math.min(1, left ?? 0)) * 100}%`;
    this.parts.fill.className = left === null ? "" : (this.vehicle.alarms.find((alarm) => alarm.rule.startsWith("battery")) || { level: "good" }).level;
  }
}

export class Cards {
  /** @param {import("./store.js").Store} store @param {import("./link.js").Link} link @param {import("./map.js").FleetMap} map */
  constructor(store, link, map) {
    this.store = store;
    this.link = link;
    this.map = map;
    /** @type {Map<string, Card>} of the selected */
    this.cards = new Map();
  }

  draw() {
    const wanted = this.store.chosen.slice(0, MOST_CARDS);
    const ids = new Set(wanted.map((vehicle) => vehicle.id));
    for (const [id, card] of this.cards) {
      if (ids.has(id)) continue;
      card.cameras.close();
      card.element.remove();
      this.cards.delete(id);
    }
    wanted.forEach((vehicle, index) => {
      const card = this.cards.get(vehicle.id) || new Card(vehicle, this.link, this.map);
      this.cards.set(vehicle.id, card);
      const place = byId("fleet").children[index];
      if (place !== card.element) byId("fleet").insertBefore(card.element, place || null);
      card.drawSafely();
    });
  }
}
