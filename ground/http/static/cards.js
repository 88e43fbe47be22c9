"use strict";
// One card a selected vehicle: what it is and does, how old that is, and its orders.

const SURFACE = new Set(["rover", "boat"]);

class Card {
  /** @param {Vehicle} vehicle */
  constructor(vehicle) {
    this.vehicle = vehicle;
    /** @type {Record<string, any>} */
    this.parts = {};
    this.element = this.build();
  }

  build() {
    const part = (name, element) => (this.parts[name] = element);
    const fact = (name, label) => make("div", "fact", "", make("dt", "", label), part(name, make("dd", "", "–")));
    const head = make("div", "card-head", "", make("h2", "", this.vehicle.name), part("what", make("span", "muted")), part("age", make("span", "age")));
    const mode = make("div", "card-mode", "", part("mode", make("span", "mode", "–")), part("armed", make("span", "pill")), part("holder", make("span", "pill info")));
    const battery = make("div", "battery", "", part("fill", make("i")));
    const facts = make("dl", "facts", "", fact("alt", "height"), fact("speed", "speed"), fact("heading", "heading"), fact("battery", "battery"), fact("gps", "GPS"), fact("loss", "link loss"), fact("place", "position"));
    const card = make("article", "card", "", head, mode, part("note", make("p", "note")), battery, facts);
    card.dataset.vehicle = this.vehicle.name;
    if (!READ_ONLY) card.append(this.buttons());
    return card;
  }

  buttons() {
    const hold = makeButton("Hold", "safe", () => order([this.vehicle.id], "hold"));
    const land = makeButton("Land", "safe", null);
    const rtl = makeButton("RTL", "safe", null);
    armTwice(land, () => order([this.vehicle.id], "land"));
    armTwice(rtl, () => order([this.vehicle.id], "rtl"));
    const arm = makeButton("Arm…", "", () => askArm(this.vehicle.id, this.vehicle.name, this.vehicle.state && this.vehicle.state.armed));
    const takeoff = makeButton("Take off…", "", () => askTakeoff(this.vehicle.id, this.vehicle.name));
    const orders = make("div", "orders", "", hold, land, rtl, arm, takeoff);
    Object.assign(this.parts, { land, arm, takeoff, orders });
    return orders;
  }

  say(part, text) {
    say(this.parts[part], text);
  }

  /** A state that is not as it should be spoils its own card and no other. */
  drawSafely() {
    try {
      this.draw();
    } catch (error) {
      this.element.classList.add("trouble");
      this.parts.note.hidden = false;
      this.say("note", "What it says of itself is not understood");
    }
  }

  draw() {
    const s = this.vehicle.state;
    const alarms = this.vehicle.stale ? this.vehicle.alarms : this.vehicle.troubles;
    const worst = alarms.length ? alarms[0].level : "";
    this.element.classList.toggle("stale", this.vehicle.stale);
    this.element.classList.toggle("trouble", worst === "bad");
    this.element.classList.toggle("armed", Boolean(s.armed));
    this.say("what", [s.kind, s.autopilot, s.sysid === null ? null : `id ${s.sysid}`].filter(Boolean).join(" · "));
    this.say("age", this.vehicle.stale ? `no word for ${span(this.vehicle.age)}` : `${span(this.vehicle.age)} ago`);
    this.say("mode", s.mode || "–");
    this.say("armed", s.armed === null ? "armed?" : s.armed ? "ARMED" : "disarmed");
    this.parts.armed.className = `pill ${s.armed ? "armed" : ""}`;
    this.parts.holder.hidden = !s.lease;
    this.say("holder", s.lease ? `held by ${s.lease.holder}` : "");
    this.parts.note.hidden = !alarms.length;
    this.parts.note.title = alarms.map((alarm) => alarm.advice).join("\n");
    this.say("note", alarms.map((alarm) => alarm.text).join(". "));
    this.drawFacts(s);
    if (READ_ONLY) return;
    this.parts.orders.hidden = s.replayed === true;
    this.parts.land.hidden = this.parts.takeoff.hidden = SURFACE.has(s.kind);
    this.say("arm", s.armed ? "Disarm…" : "Arm…");
  }

  drawFacts(s) {
    const v = s.velocity;
    this.say("alt", shown(s.position && s.position.alt_rel, 1, " m"));
    this.say("speed", shown(v && Math.hypot(v[0], v[1]), 1, " m/s"));
    this.say("heading", shown(s.attitude && ((Math.round((s.attitude.yaw * 180) / Math.PI) % 360) + 360) % 360, 0, "°"));
    this.say("gps", s.gps ? `${s.gps.fix.replace(/_/g, " ")} · ${s.gps.satellites ?? "–"}` : "–");
    this.say("loss", shown(s.link_loss * 100, 0, " %"));
    this.say("place", s.position ? `${s.position.lat_deg.toFixed(6)}, ${s.position.lon_deg.toFixed(6)}` : "–");
    const left = s.battery && s.battery.remaining;
    const volts = s.battery && s.battery.voltage;
    this.say("battery", [left === null ? null : `${Math.round(left * 100)} %`, volts === null ? null : `${volts.toFixed(1)} V`].filter(Boolean).join(" · ") || "–");
    this.parts.fill.style.width = `${Math.max(0, Math.min(1, left ?? 0)) * 100}%`;
    this.parts.fill.className = left === null ? "" : (this.vehicle.alarms.find((alarm) => alarm.rule.startsWith("battery")) || { level: "good" }).level;
  }
}
