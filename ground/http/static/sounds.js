// Alarms to hear, if a person wants it: a tone or spoken. Amber once; red again and again until somebody has seen it.

import { byId, keep, kept, make, toast } from "./dom.js";
import { LANGUAGE } from "./texts.js";
import { t } from "./words.js";

/** @typedef {"off" | "tone" | "speech"} Way */

const AGAIN_MS = 10000;

export class Sounds {
  /** @param {import("./store.js").Store} store @param {import("./alarms.js").Alarms} alarms */
  constructor(store, alarms) {
    this.store = store;
    this.alarms = alarms;
    /** @type {Way} */
    this.way = kept("sound", "off");
    /** @type {Map<string, number>} when each alarm was last heard */
    this.heard = new Map();
    /** @type {AudioContext | null} made when a person asks for it: browsers allow it only then */
    this.audio = null;
    /** @type {any} what says that nothing is heard */
    this.box = null;
    const select = make("select");
    select.id = "sound";
    for (const [value, word] of [["off", t("sound.off")], ["tone", t("sound.tone")], ["speech", t("sound.speech")]]) select.append(new Option(word, value, false, value === this.way));
    select.addEventListener("change", () => this.choose(select.value));
    byId("alarms").prepend(make("label", "quiet", "", `${t("sound")} `, select));
  }

  /** @param {Way} way */
  choose(way) {
    this.way = way;
    keep("sound", way);
    this.sound("warn", t("sound.on"));
  }

  /** A page that was loaded again has no voice before a person has used it: it says so. */
  get mute() {
    const mute = this.way !== "off" && navigator.userActivation?.hasBeenActive === false;
    if (mute && !this.box) this.box = toast(t("sound.mute"), "warn", 0);
    if (!mute && this.box) {
      this.box.remove();
      this.box = null;
    }
    return mute;
  }

  draw() {
    if (this.mute) return;
    const now = Date.now();
    const open = this.alarms.all.filter(({ key, alarm }) => (alarm.level === "bad" || alarm.level === "warn") && !this.store.seen.has(key));
    for (const key of this.heard.keys()) if (!open.some((each) => each.key === key)) this.heard.delete(key);
    for (const { key, who, alarm } of open) {
      const last = this.heard.get(key);
      if (last !== undefined && (alarm.level !== "bad" || now - last < AGAIN_MS)) continue;
      this.heard.set(key, now);
      this.sound(alarm.level, t("sound.says", { who, text: alarm.text }));
    }
  }

  /** @param {string} level @param {string} text */
  sound(level, text) {
    if (this.way === "speech") speechSynthesis.speak(Object.assign(new SpeechSynthesisUtterance(text), { lang: LANGUAGE }));
    if (this.way !== "tone") return;
    this.audio = this.audio || new AudioContext();
    for (let beep = 0; beep < (level === "bad" ? 3 : 1); beep++) {
      const tone = new OscillatorNode(this.audio, { frequency: level === "bad" ? 880 : 587 });
      tone.connect(new GainNode(this.audio, { gain: 0.2 })).connect(this.audio.destination);
      const begin = this.audio.currentTime + 0.25 * beep;
      tone.start(begin);
      tone.stop(begin + 0.15);
    }
  }
}
