// A recording that is played: REPLAY on everything, and a timeline to pause, to go elsewhere and to go faster.

import { byId, make, makeButton, say, toast } from "./dom.js";
import { post } from "./orders.js";
import { address, REPLAY } from "./settings.js";
import { span, t, wordsOf } from "./words.js";

/** @typedef {{begin: number, end: number, at: number, speed: number, paused: boolean, error: string}} Playing UTC seconds of the recording */

const SPEEDS = [0.5, 1, 2, 4, 10, 30];
const ASK_MS = 500;

export class Replay {
  /** @param {import("./store.js").Store} store */
  constructor(store) {
    this.store = store;
    /** @type {Playing | null} */
    this.playing = null;
    this.asked = 0;
    this.toggle = makeButton(t("replay.pause"), "primary", () => this.playing && this.steer({ paused: !this.playing.paused }));
    this.slider = make("input");
    Object.assign(this.slider, { type: "range", min: "0", max: "1", step: "0.1", value: "0", id: "replay-time" });
    this.slider.setAttribute("aria-label", t("replay.time"));
    this.slider.addEventListener("change", () => this.steer({ to: Number(this.slider.value) }));
    this.words = make("output");
    this.speed = make("select");
    this.speed.setAttribute("aria-label", t("replay.speed"));
    this.speed.append(...SPEEDS.map((each) => Object.assign(make("option", "", t("replay.times", { speed: String(each) })), { value: String(each) })));
    this.speed.value = "1";
    this.speed.addEventListener("change", () => this.steer({ speed: Number(this.speed.value) }));
    if (!REPLAY) return;
    document.body.classList.add("replay");
    byId("map-frame").dataset.mark = t("replay.mark");
    const bar = byId("replay");
    bar.hidden = false;
    bar.append(make("b", "replay-mark", t("replay.mark")), this.toggle, this.slider, this.words, this.speed);
    setInterval(() => this.ask(), ASK_MS);
    this.ask();
  }

  async ask() {
    const number = ++this.asked;
    try {
      const answer = await fetch(address("replay"));
      if (answer.ok && number === this.asked) this.take(await answer.json());
    } catch (error) {
      // The WebSocket says that the gateway is lost.
    }
  }

  /** @param {Partial<{paused: boolean, speed: number, to: number}>} what */
  async steer(what) {
    try {
      this.asked++;
      if (what.to !== undefined) this.store.forget();
      this.take(await post("replay", what));
    } catch (error) {
      toast(t("replay.failed", { text: wordsOf(error) }), "bad");
    }
  }

  /** @param {Playing} playing */
  take(playing) {
    this.playing = playing;
    this.store.replayAt = playing.at;
    this.slider.max = String(Math.max(1, playing.end - playing.begin));
    if (document.activeElement !== this.slider || !this.slider.matches(":active")) this.slider.value = String(playing.at - playing.begin);
    say(this.toggle, playing.paused ? t("replay.play") : t("replay.pause"));
    const at = new Date(playing.at * 1000).toLocaleString();
    const words = t("replay.words", { time: at, at: span(playing.at - playing.begin), length: span(playing.end - playing.begin) });
    say(this.words, playing.error ? t("replay.failed", { text: playing.error }) : words);
    this.slider.setAttribute("aria-valuetext", words);
  }
}
