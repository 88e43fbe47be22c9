"use strict";
// What is known: the one place that the socket writes to and that every view reads. A view changes it by its methods only.

const STALE_S = 2;
const TRAIL_MS = 120000;
const MOST_VEHICLES = 500;
const MOST_EVENTS = 100;

/** @typedef {{rule: string, level: string, text: string, advice: string}} Alarm what is not well, by the rules of zmav/doctor */

class Vehicle {
  /** @param {string} fleet @param {string} name */
  constructor(fleet, name) {
    this.fleet = fleet;
    this.name = name;
    this.id = `${fleet}/${name}`;
    /** @type {any} the last state: see zmav/wire/state.py */
    this.state = null;
    /** @type {Alarm[]} by the gateway, the worst first */
    this.alarms = [];
    this.at = 0;
    this.placed = false;
    /** @type {{at: number, lat: number, lon: number, alt: number}[]} */
    this.trail = [];
    /** @type {Place | null} */
    this.home = null;
    /** @type {Place | null} where its autopilot flies to */
    this.target = null;
    /** @type {any} what GET /report says of it */
    this.report = null;
    this.colour = "gray";
    /** @type {Alarm[]} */
    this.found = [];
    this.judged = this.judgedAt = 0;
  }

  take(state, alarms, place) {
    this.state = state;
    this.alarms = alarms || [];
    this.at = Date.now();
    this.place = place;
    this.placed = Boolean(place);
    if (!place) return;
    const last = this.trail[this.trail.length - 1];
    if (!last || this.at - last.at > 400) this.trail.push({ at: this.at, ...place, alt: this.height });
    while (this.trail.length > 300) this.trail.shift();
  }

  get age() {
    return (Date.now() - this.at) / 1000;
  }

  get stale() {
    return this.age > STALE_S;
  }

  /** m above home, or down from the fleet's origin; null: not known. */
  get height() {
    const s = this.state;
    if (s.position && Number.isFinite(s.position.alt_rel)) return s.position.alt_rel;
    return s.local ? -s.local[2] : null;
  }

  get speed() {
    return this.state.velocity ? Math.hypot(this.state.velocity[0], this.state.velocity[1]) : null;
  }

  /** Radians clockwise from north. */
  get heading() {
    return (this.state.attitude && Number(this.state.attitude.yaw)) || 0;
  }

  /** What it does, and for whom. */
  get doing() {
    const lease = this.state.lease;
    const mover = this.state.mover && this.state.mover !== "nobody" ? this.state.mover : "";
    return [mover, lease ? `for ${lease.holder}` : ""].filter(Boolean).join(" ");
  }

  /** All that is not well, the worst first. Several views ask for it while the page is drawn. @returns {Alarm[]} */
  get troubles() {
    const now = Math.floor(Date.now() / 100);
    if (this.judged !== now || this.judgedAt !== this.at) [this.judged, this.judgedAt, this.found] = [now, this.at, this.judge()];
    return this.found;
  }

  /** What the state tells, at once, and what is known beside it, a second later. @returns {Alarm[]} */
  judge() {
    if (this.stale) return [{ rule: "state", level: "bad", text: `no word for ${span(this.age)}`, advice: "is its computer on, and its router linked to this one?" }];
    const more = this.report ? this.report.reasons.filter((each) => !this.alarms.some((alarm) => alarm.rule === each.rule)) : [];
    return [...this.alarms, ...more].sort((a, b) => LEVELS.indexOf(a.level) - LEVELS.indexOf(b.level));
  }

  get level() {
    const troubles = this.troubles;
    return troubles.length ? troubles[0].level : "ok";
  }

  /** What hinders a takeoff, in the autopilot's own words where it has any. @returns {string[]} */
  get hindrances() {
    const s = this.state;
    const own = s.not_ready && s.not_ready.length ? s.not_ready : s.ready === false ? ["not ready, and it does not say why"] : [];
    const ours = this.troubles.filter((each) => each.level === "bad" && each.rule !== "not-ready").map((each) => each.text);
    return s.armed ? ours : [...ours, ...own];
  }
}

class Store {
  constructor() {
    /** @type {Map<string, Vehicle>} by fleet/name, in the order of the names */
    this.vehicles = new Map();
    /** @type {Set<string>} ids: changed by a person and by nothing else */
    this.selected = new Set();
    /** @type {{name: string, t: number, severity: string, text: string}[]} the newest first */
    this.events = [];
    this.eventCount = 0;
    /** @type {Map<string, number>} alarms seen by a person: id and rule */
    this.seen = new Map();
    /** @type {any} the planner's book; see zmav/wire/swarm.py */
    this.book = null;
    this.bookAt = 0;
    this.chargeAt = 0;
    /** @type {Map<string, any>} what is flown, by goal */
    this.plans = new Map();
    /** @type {Map<string, any>} */
    this.obstacles = new Map();
    /** @type {{a: string, b: string, grade: string, loss: number | null}[]} */
    this.links = [];
    /** @type {Place | null} the fleet's origin; null: none is known */
    this.origin = null;
    /** True where nobody knows a place on earth: then places are metres about nowhere. */
    this.nowhere = true;
    this.connection = "connecting";
    this.lastWord = 0;
    /** @type {Record<string, string[]>} groups of vehicles by a name that a person gave them */
    this.groups = kept("groups", {});
    /** Called when a person has changed what is selected: it is shown at once. */
    this.changed = () => {};
  }

  /** @param {any} message of the gateway's */
  take(message) {
    const chunks = message.key.split("/");
    if (chunks.length === 4 && chunks[3] === "state") this.takeState(chunks[1], chunks[2], message);
    else if (chunks.length === 4 && chunks[3] === "event") this.takeEvent(chunks[2], message.value);
    else if (chunks[2] === "@fleet") this.takeFleet(chunks[3], message.value);
    else if (chunks[2] === "@obstacle") this.takeObstacle(message.value);
    else if (chunks[3] === "mav" && message.value && message.value.fields) this.takeMessage(this.vehicles.get(`${chunks[1]}/${chunks[2]}`), chunks[7], message.value.fields);
  }

  takeState(fleet, name, { value: state, alarms }) {
    if (!state || typeof state !== "object") return;
    const id = `${fleet}/${name}`;
    let vehicle = this.vehicles.get(id);
    if (!vehicle) {
      if (this.vehicles.size >= MOST_VEHICLES) return;
      vehicle = new Vehicle(fleet, name);
      const all = [...this.vehicles, /** @type {[string, Vehicle]} */ ([id, vehicle])];
      this.vehicles = new Map(all.sort((a, b) => a[0].localeCompare(b[0], "en", { numeric: true })));
      [...this.vehicles.values()].forEach((each, index) => (each.colour = hue(index)));
    }
    vehicle.take(state, alarms, this.placeOf(state));
  }

  /** @returns {Place | null} */
  placeOf(state) {
    const here = state.position;
    const local = Array.isArray(state.local) && state.local.every(Number.isFinite) ? state.local : null;
    if (here && [here.lat_deg, here.lon_deg, here.alt_rel].every(Number.isFinite)) {
      const place = { lat: here.lat_deg, lon: here.lon_deg };
      if (this.nowhere) {
        this.nowhere = false;
        this.origin = null;
        for (const vehicle of this.vehicles.values()) vehicle.trail = [];
      }
      if (local && !this.origin) {
        const m = metresPerRadian(toGlobal(place, -local[0], -local[1]).lat); // at the origin's latitude, as in zmav/geo.py
        this.origin = { lat: place.lat - local[0] / m.north / RADIAN, lon: place.lon - local[1] / m.east / RADIAN };
      }
      return place;
    }
    if (!local || !this.nowhere) return local && this.origin ? toGlobal(this.origin, local[0], local[1]) : null;
    this.origin = { lat: 0, lon: 0 };
    return toGlobal(this.origin, local[0], local[1]);
  }

  takeEvent(name, event) {
    if (!event || typeof event.text !== "string") return;
    if (this.events.some((other) => other.t === event.t && other.text === event.text)) return; // heard before the connection was lost
    this.eventCount++;
    this.events.push({ name, t: event.t, severity: event.severity, text: event.text });
    this.events.sort((a, b) => b.t - a.t);
    this.events.length = Math.min(this.events.length, MOST_EVENTS);
  }

  takeFleet(topic, value) {
    if (!value || typeof value !== "object") return;
    if (topic === "charge") this.chargeAt = Date.now();
    else if (topic === "goal" && Array.isArray(value.goals)) {
      if (this.book && value.term < this.book.term) return;
      this.book = value;
      this.bookAt = this.chargeAt = Date.now();
      for (const goal of this.plans.keys()) if (!this.openGoals.some((entry) => entry.id === goal)) this.plans.delete(goal);
    } else if (topic === "plan" && value.tracks) this.plans.set(value.goal, value);
    else if (topic === "obstacle" && Array.isArray(value.obstacles)) this.obstacles = new Map(value.obstacles.map((each) => [each.name, each]));
  }

  takeObstacle(value) {
    if (!value || typeof value.name !== "string") return;
    if (value.what) this.obstacles.set(value.name, value);
    else this.obstacles.delete(value.name);
  }

  takeMessage(vehicle, name, fields) {
    if (!vehicle) return;
    const place = (lat, lon) => (lat || lon ? { lat: lat / 1e7, lon: lon / 1e7 } : null);
    if (name === "HOME_POSITION") vehicle.home = place(fields.latitude, fields.longitude);
    if (name === "POSITION_TARGET_GLOBAL_INT") vehicle.target = place(fields.lat_int, fields.lon_int);
  }

  /** What GET /report said. */
  takeReport(report) {
    this.links = report.links;
    for (const vehicle of this.vehicles.values()) vehicle.report = null;
    for (const each of report.vehicles) {
      const vehicle = this.vehicles.get(`${each.fleet}/${each.name}`);
      if (vehicle) vehicle.report = each;
    }
  }

  get all() {
    return [...this.vehicles.values()].filter((vehicle) => vehicle.state);
  }

  /** The vehicles that are selected. */
  get chosen() {
    return this.all.filter((vehicle) => this.selected.has(vehicle.id));
  }

  /** A planner is in charge and was heard within the last seconds. */
  get planner() {
    return Date.now() - this.chargeAt < 5000 && Date.now() - this.lastWord < 5000;
  }

  get openGoals() {
    return this.book ? this.book.goals.filter((entry) => !["done", "failed", "cancelled"].includes(entry.state)) : [];
  }

  // What a person does.

  /** @param {Iterable<string>} ids */
  select(ids) {
    this.selected = new Set(ids);
    this.changed();
  }

  /** @param {string} id */
  toggle(id) {
    if (!this.selected.delete(id)) this.selected.add(id);
    this.changed();
  }

  /** @param {string} name */
  saveGroup(name) {
    this.groups = { ...this.groups, [name]: [...this.selected] };
    keep("groups", this.groups);
  }

  /** @param {string} name */
  dropGroup(name) {
    const { [name]: gone, ...left } = this.groups;
    this.groups = left;
    keep("groups", left);
  }
}
