// Pictures of a vehicle's cameras, with what was found in them; they come only while a person looks.

import { make, makeButton, mark, say, toast } from "./dom.js";
import { GimbalControls } from "./gimbal.js";
import { readPictures } from "./mjpeg.js";
import { READ_ONLY, REPLAY } from "./settings.js";
import { canPlay, playVideo } from "./video.js";
import { fixed, t, wordsOf } from "./words.js";

/**
 * @typedef {import("./mjpeg.js").Picture} Picture
 * @typedef {import("./types.js").Sights} Sights
 * @typedef {import("./vehicle.js").Vehicle} Vehicle
 */

const MOST_OPEN = 2; // a browser has six connections to a host, and no order is to wait for a picture
const STOPPED_MS = 2000;
const SLOWEST_MS = 5000; // between two pictures of a camera that sends as slowly as it may: more was a stop
const SLOWER = 3; // times what lay between the pictures before
const AGAIN_MS = 3000;
const NO_VIDEO_MS = 10000; // without a picture of a video: it is no video that this browser can play
const SEEN_S = 0.5; // what was found in an older picture is not where it was
const MOST_BOXES = 200;
const COLOUR = "#3dff7a";

/** Those whose pictures are shown, the longest first. @type {Set<CameraView>} */
const open = new Set();
document.addEventListener("visibilitychange", () => {
  for (const view of open) document.hidden ? view.stop() : view.start();
});

class CameraView {
  /** @param {Vehicle} vehicle @param {string} name @param {import("./link.js").Link} link @param {import("./map.js").FleetMap} map */
  constructor(vehicle, name, link, map) {
    this.vehicle = vehicle;
    this.name = name;
    this.link = link;
    this.key = `zmav/${vehicle.id}/camera/${name}/detection`;
    this.button = makeButton(t("camera.button", { name }), "small", () => (open.has(this) ? this.close() : this.show()));
    this.canvas = make("canvas");
    this.canvas.setAttribute("role", "img");
    this.stopped = make("p", "note");
    this.stopped.setAttribute("role", "status");
    this.about = make("p", "muted");
    this.box = make("div", "camera", "", this.canvas, this.stopped, this.about);
    if (!READ_ONLY) this.box.append(new GimbalControls(vehicle, name, this.canvas, map).element);
    /** @type {AbortController | null} of the stream */
    this.stream = null;
    /** @type {ReturnType<typeof setTimeout> | undefined} */
    this.again = undefined;
    /** @type {Picture | null} that waits to be decoded */
    this.next = null;
    /** @type {{image: ImageBitmap, t: number} | null} on the canvas */
    this.shown = null;
    this.decoding = false;
    /** @type {HTMLVideoElement | null} that plays, unseen: its pictures go onto the canvas */
    this.video = null;
    this.noVideo = false; // it was tried: pictures are read instead
    this.at = this.between = 0; // ms: when the last picture came; what lies between two
    this.since = 0;
    this.why = "";
  }

  show() {
    for (const view of [...open].slice(0, open.size + 1 - MOST_OPEN)) {
      view.close();
      toast(t("camera.most", { most: MOST_OPEN, who: view.vehicle.name, name: view.name }), "warn");
    }
    open.add(this);
    this.noVideo = false;
    this.at = this.between = 0;
    this.since = Date.now();
    this.why = "";
    this.shown = null;
    this.link.subscribe(this.key, { hz: 15 });
    this.start();
    this.draw();
  }

  close() {
    if (!open.delete(this)) return;
    this.link.unsubscribe(this.key);
    this.stop();
    this.shown?.image.close();
    this.shown = this.next = null;
    this.draw();
  }

  stop() {
    clearTimeout(this.again);
    this.stream?.abort();
    this.stream = this.video = null;
  }

  /** The vehicle has a video of this camera, and this browser may show it. */
  get hasVideo() {
    return canPlay && !this.noVideo && Boolean(this.vehicle.videos.get(this.name)?.there);
  }

  async start() {
    this.stop();
    const stream = new AbortController();
    this.stream = stream;
    const path = `camera/${this.vehicle.name}/${this.name}`;
    const video = this.hasVideo;
    try {
      if (video) await this.play(path, stream);
      else await readPictures(path, stream.signal, (picture) => this.take(picture));
    } catch (error) {
      if (stream === this.stream) {
        this.why = wordsOf(error);
        this.noVideo ||= video && this.vehicle.cameras.has(this.name); // which has pictures besides
      }
    }
    if (stream === this.stream) this.again = setTimeout(() => this.start(), AGAIN_MS);
  }

  /** @param {string} path @param {AbortController} stream */
  async play(path, stream) {
    const video = make("video");
    Object.assign(video, { muted: true, playsInline: true });
    this.video = video;
    const painted = async () => {
      if (this.video !== video) return;
      video.requestVideoFrameCallback(painted);
      try {
        const image = await createImageBitmap(video);
        if (this.video === video) this.display(image, Date.now() / 1000);
        else image.close(); // of what was left meanwhile
      } catch (error) {
        // one that is not there yet
      }
    };
    video.requestVideoFrameCallback(painted);
    try {
      await playVideo(`${path}/webrtc`, stream.signal, video);
    } finally {
      video.srcObject = null;
    }
  }

  /** @param {ImageBitmap} image @param {number} taken UTC s */
  display(image, taken) {
    if (!open.has(this)) return image.close(); // nobody looks any more
    this.shown?.image.close();
    this.shown = { image, t: taken };
    this.came();
    this.paint();
  }

  /** The newest wins, also over one that is being decoded. @param {Picture} picture */
  async take(picture) {
    this.next = picture;
    if (this.decoding) return;
    this.decoding = true;
    while (this.next) {
      const { jpeg, t: taken } = this.next;
      this.next = null;
      try {
        this.display(await createImageBitmap(jpeg), taken);
      } catch (error) {
        this.why = t("camera.garbled");
      }
    }
    this.decoding = false;
  }

  /** A picture was shown: one that is none does not pass for a sign of life. */
  came() {
    const now = Date.now();
    const gap = Math.min(now - this.at, SLOWEST_MS);
    if (this.at) this.between = this.between ? 0.8 * this.between + 0.2 * gap : gap;
    this.at = now;
    this.why = "";
  }

  /** What was found in this picture, or in one shortly before. @returns {Sights | null} */
  get sights() {
    const sights = this.vehicle.sights.get(this.name);
    return sights && this.shown && Math.abs(this.shown.t - sights.t) < SEEN_S ? sights : null;
  }

  paint() {
    if (!this.shown) return;
    const { image, t: taken } = this.shown;
    const { canvas, sights } = this;
    if (canvas.width !== image.width || canvas.height !== image.height) Object.assign(canvas, { width: image.width, height: image.height });
    const to = canvas.getContext("2d");
    to.drawImage(image, 0, 0);
    const found = sights ? sights.found.slice(0, MOST_BOXES) : [];
    if (sights) {
      to.globalAlpha = 1 - (0.7 * Math.abs(taken - sights.t)) / SEEN_S; // what is older is paler
      for (const each of found) this.paintOne(to, each, image.width / sights.width, canvas.clientWidth ? image.width / canvas.clientWidth : 1);
      to.globalAlpha = 1;
    }
    const words = found.map((each) => t("camera.found", { symbol: each.symbol, percent: Math.round(each.score * 100) })).join(", ");
    mark(canvas, "aria-label", words ? t("camera.label.found", { who: this.vehicle.name, name: this.name, words }) : t("camera.label", { who: this.vehicle.name, name: this.name }));
  }

  /**
   * A square about its middle, turned as it lies, and what it is.
   * @param {CanvasRenderingContext2D} to @param {import("./types.js").Sight} sight @param {number} scale of this picture to the one in which it was found @param {number} px of the picture in one of the screen
   */
  paintOne(to, sight, scale, px) {
    const [u, v, side] = [sight.u * scale, sight.v * scale, Math.max(sight.scale_px * scale * 1.3, 8 * px)];
    for (const [colour, width] of /** @type {[string, number][]} */ ([["#000", 5], [COLOUR, 2.5]])) {
      to.save();
      to.translate(u, v);
      to.rotate(sight.heading);
      to.strokeStyle = colour;
      to.lineWidth = width * px;
      to.strokeRect(-side / 2, -side / 2, side, side);
      to.restore();
    }
    to.font = `600 ${14 * px}px ${getComputedStyle(to.canvas).fontFamily}`;
    to.textAlign = "center";
    to.lineWidth = 4 * px;
    to.strokeStyle = "#000";
    to.fillStyle = COLOUR;
    const words = t("camera.found", { symbol: sight.symbol, percent: Math.round(sight.score * 100) });
    const below = v + side * 0.71 + 16 * px; // under the square, however it is turned; above where that is outside
    const y = below < to.canvas.height - 3 * px ? below : v - side * 0.71 - 6 * px;
    to.strokeText(words, u, y);
    to.fillText(words, u, y);
  }

  /** Why no picture comes, as far as anybody says. */
  get reason() {
    const status = (this.hasVideo ? this.vehicle.videos : this.vehicle.cameras).get(this.name);
    if (this.why) return this.why;
    if (status && !status.fresh) return t("camera.silent");
    return status && status.state !== "sending" ? status.text : "";
  }

  draw() {
    const showing = open.has(this);
    mark(this.button, "aria-pressed", String(showing));
    this.box.hidden = !showing;
    if (!showing) return;
    const last = this.at || this.since;
    const stopped = Date.now() - last > Math.max(STOPPED_MS, SLOWER * this.between);
    this.box.classList.toggle("stopped", stopped);
    if (this.video && Date.now() - last > NO_VIDEO_MS && this.vehicle.cameras.get(this.name)?.there) {
      this.noVideo = true;
      this.start();
    }
    this.canvas.hidden = !this.shown;
    this.stopped.hidden = !stopped;
    if (stopped) {
      const time = new Date(last).toLocaleTimeString([], { hour12: false });
      const words = this.at ? t("camera.stopped", { time }) : t("camera.none", { time });
      say(this.stopped, [words, this.reason].filter(Boolean).join(": "));
    }
    const rate = this.between ? t("camera.rate", { hz: fixed(1000 / this.between, 1) }) : "";
    say(this.about, stopped ? "" : this.shown ? [t("camera.size", { width: this.canvas.width, height: this.canvas.height }), rate, this.video ? t("camera.video") : ""].filter(Boolean).join(" · ") : t("camera.waits"));
    this.paint();
  }
}

/** The cameras of one vehicle: a button each, and pictures below it. */
export class CameraViews {
  /** @param {Vehicle} vehicle @param {import("./link.js").Link} link @param {import("./map.js").FleetMap} map */
  constructor(vehicle, link, map) {
    this.vehicle = vehicle;
    this.link = link;
    this.map = map;
    this.buttons = make("div", "chips");
    this.element = make("div", "cameras", "", this.buttons);
    /** @type {Map<string, CameraView>} */
    this.views = new Map();
  }

  draw() {
    const { cameras, videos } = this.vehicle;
    for (const name of [...cameras.keys(), ...videos.keys()]) if (!this.views.has(name)) this.add(name);
    for (const [name, view] of this.views) {
      const there = open.has(view) || Boolean(cameras.get(name)?.there || videos.get(name)?.there);
      view.button.hidden = !there;
      view.draw();
    }
    this.element.hidden = REPLAY || ![...this.views.values()].some((view) => !view.button.hidden);
  }

  /** @param {string} name */
  add(name) {
    const view = new CameraView(this.vehicle, name, this.link, this.map);
    this.views.set(name, view);
    this.buttons.append(view.button);
    this.element.append(view.box);
  }

  close() {
    for (const view of this.views.values()) view.close();
  }
}
