// In a camera's panel: where its vehicle's gimbal looks, zoom, photos. Nothing here moves the vehicle.

import { make, makeButton, toast } from "./dom.js";
import { order, post } from "./orders.js";
import { t, wordsOf } from "./words.js";

/** @typedef {import("./vehicle.js").Vehicle} Vehicle */

const ACROSS = Math.PI / 3; // rad that the picture's width is taken for while it is dragged
const LEAST_PX = 4; // a drag that is shorter was a click
const CLOSER = 1.5;
const MOST_ZOOM = 8;

export class GimbalControls {
  /** @param {Vehicle} vehicle @param {string} name the camera's @param {HTMLCanvasElement} canvas @param {import("./map.js").FleetMap} map */
  constructor(vehicle, name, canvas, map) {
    this.vehicle = vehicle;
    this.name = name;
    this.canvas = canvas;
    this.map = map;
    this.zoomed = 1;
    this.busy = false;
    /** Where the drag began: px, and pitch and yaw in rad. @type {{x: number, y: number, pitch: number, yaw: number} | null} */
    this.from = null;
    /** Where the pointer was last, and is not turned to yet: px. @type {{x: number, y: number} | null} */
    this.to = null;
    this.held = false;
    const centre = () => order([vehicle.id], "gimbal_turn", { take: true });
    const release = () => order([vehicle.id], "gimbal_release");
    const buttons = [
      makeButton(t("gimbal.photo"), "small", () => this.photo(), t("gimbal.photo.title")),
      makeButton(t("gimbal.in"), "small", () => this.zoom(CLOSER), t("gimbal.in.title")),
      makeButton(t("gimbal.out"), "small", () => this.zoom(1 / CLOSER), t("gimbal.out.title")),
      makeButton(t("gimbal.look"), "small", () => this.look(), t("gimbal.look.title")),
      makeButton(t("gimbal.centre"), "small", centre, t("gimbal.centre.title")),
      makeButton(t("gimbal.release"), "small", release, t("gimbal.release.title")),
    ];
    this.element = make("div", "chips", "", ...buttons);
    canvas.style.touchAction = "none";
    canvas.addEventListener("pointerdown", (event) => this.grab(event));
    canvas.addEventListener("pointermove", (event) => this.drag(event));
    canvas.addEventListener("pointerup", (event) => this.drop(event));
    canvas.addEventListener("pointercancel", () => (this.held = false)); // it says no place
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(event.deltaY < 0 ? CLOSER : 1 / CLOSER);
    });
  }

  /** Ask, one at a time; what is refused is said. @param {string} path @param {any} args @returns {Promise<any>} */
  async ask(path, args) {
    if (this.busy) return null;
    this.busy = true;
    try {
      return (await post(path, args)).result;
    } catch (error) {
      toast(t("gimbal.refused", { who: this.vehicle.name, text: wordsOf(error) }), "bad", 12000);
      return null;
    } finally {
      this.busy = false;
    }
  }

  async photo() {
    const taken = await this.ask(`agent/${this.vehicle.name}/photos-${this.name}/photo`, {});
    if (taken) toast(t("gimbal.taken", { who: this.vehicle.name, number: taken.number, file: taken.file }), "good");
  }

  /** @param {number} times */
  async zoom(times) {
    const factor = Math.min(Math.max(this.zoomed * times, 1), MOST_ZOOM);
    const told = await this.ask(`agent/${this.vehicle.name}/photos-${this.name}/zoom`, { factor });
    if (told) this.zoomed = told.factor;
  }

  /** At the place of the map that is clicked next. */
  look() {
    this.map.begin(t("gimbal.tool", { who: this.vehicle.name }), {
      name: "look",
      click: (place) => {
        this.map.end();
        order([this.vehicle.id], "gimbal_point", { lat_deg: place.lat, lon_deg: place.lon });
      },
    });
  }

  // The picture is dragged as a map is: what is under the pointer stays there.

  /** @param {PointerEvent} event */
  async grab(event) {
    if (event.button !== 0) return;
    this.canvas.setPointerCapture(event.pointerId);
    this.from = this.to = null;
    this.held = true;
    const now = await this.ask(`do/${this.vehicle.name}/gimbal_status`, {});
    if (now) this.from = { x: event.clientX, y: event.clientY, pitch: now.pitch, yaw: now.yaw ?? 0 };
    await this.turn();
  }

  /** @param {PointerEvent} event */
  async drag(event) {
    if (!this.held) return;
    this.to = { x: event.clientX, y: event.clientY };
    await this.turn();
  }

  /** @param {PointerEvent} event */
  async drop(event) {
    await this.drag(event);
    this.held = false;
  }

  /** To where the pointer was last, also where that was told while an answer was awaited. */
  async turn() {
    while (this.from && this.to && !this.busy) {
      const { x, y, pitch, yaw } = this.from;
      const [right, down] = [this.to.x - x, this.to.y - y];
      this.to = null;
      if (Math.hypot(right, down) < LEAST_PX) continue;
      const each = ACROSS / this.zoomed / Math.max(this.canvas.clientWidth, 1);
      const told = await this.ask(`do/${this.vehicle.name}/gimbal_turn`, { pitch: pitch + down * each, yaw: yaw - right * each });
      if (!told) this.from = null; // said once, not at every step
    }
  }
}
