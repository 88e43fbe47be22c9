// What is known: the one place that the socket writes to and that every view reads. A view changes it by its methods only.

import { hue, keep, kept } from "./dom.js";
import { metresPerRadian, RADIAN, toGlobal, toNed } from "./geo.js";
import { REPLAY } from "./settings.js";
import { Vehicle } from "./vehicle.js";

/**
 * @typedef {import("./types.js").Message} Message
 * @typedef {import("./types.js").State} State
 * @typedef {import("./types.js").Place} Place
 */

const MOST_VEHICLES = 500;
const MOST_BASES = 8;
const MOST_EVENTS = 100;
const SEEN_MS = 3600000; // what was seen before is another day's alarm to a page that was closed meanwhile

export class Store {
  constructor() {
    /** @type {Map<string, Vehicle>} by fleet/name, in the order of the names */
    this.vehicles = new Map();
    /** @type {Set<string>} ids: changed by a person and by nothing else */
    this.selected = new Set();
    /** @type {import("./types.js").FleetEvent[]} the newest first */
    this.events = [];
    this.eventCount = 0;
    /** @type {Map<string, number>} alarms seen by a person: id and rule */
    this.seen = new Map(kept("seen", []).filter((/** @type {[string, number]} */ [, at]) => Date.now() - at < SEEN_MS));
    /** @type {import("./types.js").Book | null} */
    this.book = null;
    this.chargeAt = 0;
    /** @type {Map<string, {state: string, text: string, at: number}>} */
    this.bases = new Map();
    /** @type {Map<string, import("./types.js").Plan>} what is flown, by goal */
    this.plans = new Map();
    /** @type {Map<string, import("./types.js").Obstacle>} by name */
    this.obstacles = new Map();
    /** @type {import("./types.js").Aircraft[]} that are not of the fleet, the nearest first */
    this.aircraft = [];
    this.aircraftAt = 0;
    /** @type {import("./types.js").MeshLink[]} */
    this.links = [];
    /** @type {Place | null} the fleet's origin; null: none is known */
    this.origin = null;
    /** True where nobody knows a place on earth: then places are metres about nowhere. */
    this.nowhere = true;
    /** @type {"connecting" | "live" | "lost"} */
    this.connection = "connecting";
    this.lastWord = 0;
    /** Where a recording is that is played, UTC s. */
    this.replayAt = 0;
    /** @type {Record<string, string[]>} groups of vehicles by a name that a person gave them */
    this.groups = kept("groups", {});
    /** Called when a person has changed what is selected: it is shown at once. */
    this.changed = () => {};
  }

  /** @param {Message} message */
  take(message) {
    const chunks = message.key.split("/");
    if (chunks.length === 4 && chunks[3] === "state") this.takeState(chunks[1], chunks[2], message);
    else if (chunks.length === 4 && chunks[3] === "event") this.takeEvent(chunks[2], message.value);
    else if (chunks[2] === "@fleet") this.takeFleet(chunks[3], message.value);
    else if (chunks[2] === "@obstacle") this.takeObstacle(message.value);
    else if (chunks[3] === "agent" && chunks[4] === "rtk") this.takeBase(chunks[2], message.value);
    else if (chunks[3] === "agent") this.vehicles.get(`${chunks[1]}/${chunks[2]}`)?.takeStatus(chunks[4], message.value);
    else if (chunks[3] === "camera") this.vehicles.get(`${chunks[1]}/${chunks[2]}`)?.takeSights(chunks[4], message.value);
    else if (chunks[3] === "mav" && message.value && message.value.fields) this.takeMessage(this.vehicles.get(`${chunks[1]}/${chunks[2]}`), chunks[7], message.value.fields);
  }

  /** @param {string} fleet @param {string} name @param {Message} message */
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
    vehicle.take(state, alarms || [], this.placeOf(vehicle, state));
    if (REPLAY) vehicle.clock = () => this.replayAt;
  }

  /** @param {Vehicle} vehicle @param {State} state @returns {Place | null} */
  placeOf(vehicle, state) {
    const here = state.position;
    const local = Array.isArray(state.local) && state.local.every(Number.isFinite) ? state.local : null;
    if (here && [here.lat_deg, here.lon_deg, here.alt_rel].every(Number.isFinite)) {
      const place = { lat: here.lat_deg, lon: here.lon_deg };
      if (this.nowhere) {
        this.nowhere = false;
        this.origin = null;
        for (const each of this.vehicles.values()) each.trail = [];
      }
      if (local) {
        const m = metresPerRadian(toGlobal(place, -local[0], -local[1]).lat); // at the origin's latitude, as in zmav/geo.py
        vehicle.origin = { lat: place.lat - local[0] / m.north / RADIAN, lon: place.lon - local[1] / m.east / RADIAN };
        const agrees = (/** @type {Vehicle} */ each) => this.origin && each.origin && Math.hypot(...toNed(this.origin, each.origin)) <= 1;
        // One that has another origin moves nobody's, while any that is heard has the one that is known.
        if (!agrees(vehicle) && ![...this.vehicles.values()].some((each) => !each.stale && agrees(each))) this.origin = vehicle.origin;
      }
      return place;
    }
    if (!local || !this.nowhere) return local && this.origin ? toGlobal(this.origin, local[0], local[1]) : null;
    this.origin = { lat: 0, lon: 0 };
    return toGlobal(this.origin, local[0], local[1]);
  }

  /** @param {string} name @param {any} event */
  takeEvent(name, event) {
    if (!event || typeof event.text !== "string") return;
    if (this.events.some((other) => other.t === event.t && other.text === event.text)) return; // heard before the connection was lost
    this.eventCount++;
    this.events.push({ name, t: event.t, severity: event.severity, text: event.text });
    this.events.sort((a, b) => b.t - a.t);
    this.events.length = Math.min(this.events.length, MOST_EVENTS);
  }

  /** @param {string} topic @param {any} value */
  takeFleet(topic, value) {
    if (!value || typeof value !== "object") return;
    if (topic === "charge") this.chargeAt = Date.now();
    else if (topic === "goal" && Array.isArray(value.goals)) {
      if (this.book && value.term < this.book.term) return;
      this.book = value;
      this.chargeAt = Date.now();
      for (const goal of this.plans.keys()) if (!this.openGoals.some((entry) => entry.id === goal)) this.plans.delete(goal);
    } else if (topic === "plan" && value.tracks) this.plans.set(value.goal, value);
    else if (topic === "obstacle" && Array.isArray(value.obstacles)) this.obstacles = new Map(value.obstacles.map((/** @type {import("./types.js").Obstacle} */ each) => [each.name, each]));
  }

  /** A source of corrections, on whichever host. @param {string} host @param {any} status */
  takeBase(host, status) {
    if (!status || typeof status.state !== "string" || (!this.bases.has(host) && this.bases.size >= MOST_BASES)) return;
    this.bases.set(host, { state: status.state, text: String(status.text ?? ""), at: Date.now() });
  }

  /** Sources of corrections that spoke of late, by host. */
  get sources() {
    return [...this.bases].filter(([, base]) => Date.now() - base.at < 5000);
  }

  /** @param {any} value */
  takeObstacle(value) {
    if (!value || typeof value.name !== "string") return;
    if (value.what) this.obstacles.set(value.name, value);
    else this.obstacles.delete(value.name);
  }

  /** @param {Vehicle | undefined} vehicle @param {string} name @param {any} fields */
  takeMessage(vehicle, name, fields) {
    if (!vehicle) return;
    const place = (/** @type {number} */ lat, /** @type {number} */ lon) => (lat || lon ? { lat: lat / 1e7, lon: lon / 1e7 } : null);
    if (name === "HOME_POSITION") vehicle.home = place(fields.latitude, fields.longitude);
    if (name === "POSITION_TARGET_GLOBAL_INT") vehicle.aimAt(place(fields.lat_int, fields.lon_int));
  }

  /** @param {import("./types.js").Report} report */
  takeReport(report) {
    this.links = report.links;
    this.aircraft = report.aircraft;
    this.aircraftAt = Date.now();
    for (const vehicle of this.vehicles.values()) vehicle.report = null;
    for (const each of report.vehicles) {
      const vehicle = this.vehicles.get(`${each.fleet}/${each.name}`);
      if (vehicle) vehicle.report = each;
    }
  }

  get all() {
    return [...this.vehicles.values()];
  }

  /** @param {string} name */
  named(name) {
    return this.all.find((vehicle) => vehicle.name === name);
  }

  /** @param {string} name of a vehicle */
  colourOf(name) {
    return this.named(name)?.colour ?? "gray";
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

  /** A recording is played from elsewhere: what was heard of another time. */
  forget() {
    for (const vehicle of this.vehicles.values()) vehicle.trail = [];
    this.events = [];
    this.eventCount = 0;
    this.book = null;
    this.plans.clear();
    this.obstacles.clear();
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

  /** A person knows of an alarm. @param {string} key */
  see(key) {
    this.seen.set(key, Date.now());
    keep("seen", [...this.seen]);
    this.changed();
  }

  /** What is not there any more comes as new the next time. @param {(key: string) => boolean} there */
  keepSeen(there) {
    const left = [...this.seen].filter(([key]) => there(key));
    if (left.length === this.seen.size) return;
    this.seen = new Map(left);
    keep("seen", left);
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
