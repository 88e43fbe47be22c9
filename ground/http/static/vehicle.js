// One vehicle: what it says, what that means, and what is not well with it.

import { LEVELS, span, t } from "./words.js";

/** @typedef {import("./types.js").Alarm} Alarm @typedef {import("./types.js").Place} Place @typedef {import("./types.js").State} State @typedef {import("./types.js").Level} Level */

const STALE_S = 2;
const AIM_MS = 5000; // a target that was said before that is none any more
const MOST_POINTS = 300; // of a track
const MOST_CAMERAS = 8;
const CAMERA_MS = 5000; // a camera says each second how it is
const GONE_MS = 15000;

/** What a camera's program says of it. */
class CameraStatus {
  /** @param {string} state @param {string} text */
  constructor(state, text) {
    this.state = state;
    this.text = text;
    this.at = Date.now();
  }

  get fresh() {
    return Date.now() - this.at < CAMERA_MS;
  }

  get there() {
    return Date.now() - this.at < GONE_MS;
  }
}

export class Vehicle {
  /** @param {string} fleet @param {string} name */
  constructor(fleet, name) {
    this.fleet = fleet;
    this.name = name;
    this.id = `${fleet}/${name}`;
    /** @type {State} the last one; empty before the first */
    this.state = {};
    /** @type {Alarm[]} by the gateway, the worst first */
    this.alarms = [];
    this.at = 0;
    /** @type {Place | null} */
    this.place = null;
    /** @type {{at: number, lat: number, lon: number, alt: number | null}[]} alt: see above */
    this.trail = [];
    /** @type {Place | null} the origin that its local place is about */
    this.origin = null;
    /** @type {Place | null} */
    this.home = null;
    /** @type {Place | null} where its autopilot flies to */
    this.target = null;
    this.aimedAt = 0;
    /** @type {import("./types.js").VehicleReport | null} */
    this.report = null;
    /** @type {Map<string, CameraStatus>} by name */
    this.cameras = new Map();
    /** @type {Map<string, CameraStatus>} by name: those with video */
    this.videos = new Map();
    /** @type {Map<string, import("./types.js").Sights>} the last ones, by camera */
    this.sights = new Map();
    this.colour = "gray";
    /** @type {Alarm[]} */
    this.found = [];
    this.judged = this.judgedAt = 0;
    /** @type {(() => number) | null} UTC s of a recording that is played, by which it is old */
    this.clock = null;
  }

  /** @param {State} state @param {Alarm[]} alarms @param {Place | null} place */
  take(state, alarms, place) {
    this.state = state;
    this.alarms = alarms;
    this.at = Date.now();
    this.place = place;
    if (!place) return;
    const last = this.trail[this.trail.length - 1];
    if (!last || this.at - last.at > 400) this.trail.push({ at: this.at, ...place, alt: this.above });
    while (this.trail.length > MOST_POINTS) this.trail.shift();
  }

  /** @param {string} agent @param {any} status */
  takeStatus(agent, status) {
    const [, kind, name] = /^(camera|video)-(.+)$/.exec(agent) ?? [];
    if (!name || !status || typeof status.state !== "string") return;
    const known = kind === "video" ? this.videos : this.cameras;
    if (known.has(name) || known.size < MOST_CAMERAS) known.set(name, new CameraStatus(status.state, String(status.text)));
  }

  /** @param {string} camera @param {any} sights */
  takeSights(camera, sights) {
    if (!sights || !Array.isArray(sights.found) || !(sights.width > 0) || !this.cameras.has(camera)) return;
    const found = sights.found.filter((/** @type {any} */ each) => each && [each.u, each.v, each.scale_px, each.heading, each.score].every(Number.isFinite));
    this.sights.set(camera, { ...sights, found });
  }

  /** @param {Place | null} place */
  aimAt(place) {
    this.target = place;
    this.aimedAt = Date.now();
  }

  /** Where its autopilot flies to, as long as it says so. */
  get aim() {
    return Date.now() - this.aimedAt < AIM_MS ? this.target : null;
  }

  get age() {
    if (this.clock) return Math.max(0, this.clock() - (this.state.t || 0));
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

  /** m above the fleet's origin, or above home where none is known. */
  get above() {
    return this.state.local ? -this.state.local[2] : this.height;
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
    return [mover, lease ? t("doing.for", { holder: lease.holder }) : ""].filter(Boolean).join(" ");
  }

  /** All that is not well, the worst first. Several views ask for it while the page is drawn. @returns {Alarm[]} */
  get troubles() {
    const now = Math.floor(Date.now() / 100);
    if (this.judged !== now || this.judgedAt !== this.at) [this.judged, this.judgedAt, this.found] = [now, this.at, this.judge()];
    return this.found;
  }

  /** What the state tells, at once, and what is known beside it, a second later. @returns {Alarm[]} */
  judge() {
    if (this.stale) return [{ rule: "state", level: "bad", text: t("vehicle.silent", { span: span(this.age) }), advice: t("vehicle.silent.advice") }];
    const more = this.report ? this.report.reasons.filter((each) => !this.alarms.some((alarm) => alarm.rule === each.rule)) : [];
    return [...this.alarms, ...more].sort((a, b) => LEVELS.indexOf(a.level) - LEVELS.indexOf(b.level));
  }

  /** @returns {Level} */
  get level() {
    const troubles = this.troubles;
    return troubles.length ? troubles[0].level : "ok";
  }

  /** What hinders a takeoff, in the autopilot's own words where it has any. @returns {string[]} */
  get hindrances() {
    const s = this.state;
    const own = s.not_ready && s.not_ready.length ? s.not_ready : s.ready === false ? [t("preflight.unsaid")] : [];
    const ours = this.troubles.filter((each) => each.level === "bad" && each.rule !== "not-ready").map((each) => each.text);
    return s.armed ? ours : [...ours, ...own];
  }
}
