"use strict";
// One card a vehicle: what it is and does, how old that is, and its orders.

const STALE_S = 2;
const SURFACE = new Set(["rover", "boat"]);

// A height of -0.04 m is 0.0, not -0.0.
const fixed = (value, digits) => value.toFixed(digits).replace(/^-(?=0(\.0*)?$)/, "");
// A dash for what is not known.
const shown = (value, digits, unit = "") => (value === null || value === undefined ? "–" : `${fixed(value, digits)}${unit}`);

function span(seconds) {
  if (seconds < 10) return `${seconds.toFixed(1)} s`;
  if (seconds < 90) return `${Math.round(seconds)} s`;
  return seconds < 5400 ? `${Math.round(seconds / 60)} min` : `${Math.round(seconds / 3600)} h`;
}

class Card {
  constructor(fleet, name) {
    this.fleet = fleet;
    this.name = name;
    this.id = `${fleet}/${name}`;
    this.state = null;
    this.alarms = []; // by the gateway, the worst first
    this.at = 0;
    this.trail = [];
    this.parts = {};
    this.element = this.build();
  }

  build() {
    const part = (name, element) => (this.parts[name] = element);
    const fact = (name, label) => make("div", "fact", "", make("dt", "", label), part(name, make("dd", "", "–")));
    const head = make("div", "card-head", "", make("h2", "", this.name), part("what", make("span", "muted")), part("age", make("span", "age")));
    const mode = make("div", "card-mode", "", part("mode", make("span", "mode", "–")), part("armed", make("span", "pill")), part("holder", make("span", "pill info")));
    const battery = make("div", "battery", "", part("fill", make("i")));
    const facts = make("dl", "facts", "", fact("alt", "height"), fact("speed", "speed"), fact("heading", "heading"), fact("battery", "battery"), fact("gps", "GPS"), fact("loss", "link loss"), fact("place", "position"));
    const card = make("article", "card", "", head, mode, part("note", make("p", "note")), battery, facts);
    card.dataset.vehicle = this.name;
    if (!READ_ONLY) card.append(this.buttons());
    return card;
  }

  buttons() {
    const button = (label, className, act) => {
      const made = make("button", className, label);
      made.type = "button";
      if (act) made.addEventListener("click", act);
      return made;
    };
    const hold = button("Hold", "safe", () => order([this.id], "hold"));
    const land = button("Land", "safe");
    const rtl = button("RTL", "safe");
    armTwice(land, () => order([this.id], "land"));
    armTwice(rtl, () => order([this.id], "rtl"));
    const arm = button("Arm…", "", () => askArm(this.id, this.name, this.state && this.state.armed));
    const takeoff = button("Take off…", "", () => askTakeoff(this.id, this.name));
    const orders = make("div", "orders", "", hold, land, rtl, arm, takeoff);
    Object.assign(this.parts, { land, arm, takeoff, orders });
    return orders;
  }

  take(state, alarms) {
    this.state = state;
    this.alarms = alarms || [];
    this.at = Date.now();
    const here = state.position;
    this.placed = Boolean(here) && [here.lat_deg, here.lon_deg, here.alt_rel].every(Number.isFinite);
    if (!this.placed) return;
    const last = this.trail[this.trail.length - 1];
    if (!last || this.at - last.at > 400) this.trail.push({ at: this.at, lat: here.lat_deg, lon: here.lon_deg });
    while (this.trail.length > 300) this.trail.shift();
  }

  get age() {
    return (Date.now() - this.at) / 1000;
  }

  get stale() {
    return this.age > STALE_S;
  }

  say(part, text) {
    if (this.parts[part].textContent !== text) this.parts[part].textContent = text;
  }

  // A state that is not as it should be spoils its own card and no other.
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
    const s = this.state;
    const worst = this.alarms.length ? this.alarms[0].level : "";
    this.element.classList.toggle("stale", this.stale);
    this.element.classList.toggle("trouble", worst === "bad");
    this.element.classList.toggle("armed", Boolean(s.armed));
    this.say("what", [s.kind, s.autopilot, s.sysid === null ? null : `id ${s.sysid}`].filter(Boolean).join(" · "));
    this.say("age", this.stale ? `no word for ${span(this.age)}` : `${span(this.age)} ago`);
    this.say("mode", s.mode || "–");
    this.say("armed", s.armed === null ? "armed?" : s.armed ? "ARMED" : "disarmed");
    this.parts.armed.className = `pill ${s.armed ? "hot" : ""}`;
    this.parts.holder.hidden = !s.lease;
    this.say("holder", s.lease ? `held by ${s.lease.holder}` : "");
    this.parts.note.hidden = !this.alarms.length;
    this.parts.note.title = this.alarms.map((alarm) => alarm.advice).join("\n");
    this.say("note", this.alarms.map((alarm) => alarm.text).join(". "));
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
    this.parts.fill.className = left === null ? "" : (this.alarms.find((alarm) => alarm.rule.startsWith("battery")) || { level: "good" }).level;
  }
}
