// Any key expression, live: the newest value of each key, how fast it comes and how old it is.

import { byId, make, makeButton } from "./dom.js";
import { Link } from "./link.js";
import { span, t } from "./words.js";

const MOST_SHOWN = 200;

/**
 * @typedef {import("./types.js").Message} Message
 * @typedef {{key: string, element: HTMLDetailsElement, table: HTMLElement, rate: HTMLElement, times: number[], value: any, fresh: boolean}} Entry
 */

/** Whether a key expression takes a key in: * is a chunk, ** any number of them, $* any part of one. @param {string} expression @param {string} key */
function takes(expression, key) {
  const pattern = expression
    .split("/")
    .map((chunk) => (chunk === "**" ? "**" : chunk === "*" ? "[^/@][^/]*" : chunk.replace(/[.+?^{}()|[\]\\]/g, "\\$&").replace(/\$\*/g, "[^/]*")))
    .join("/")
    .replace(/\*\*\/|\/\*\*|\*\*/g, (stars) => (stars.endsWith("/") ? "(?:[^/@][^/]*/)*" : stars.startsWith("/") ? "(?:/[^/@][^/]*)*" : "[^@].*"));
  return new RegExp(`^${pattern}$`).test(key);
}

/** @param {any} value @returns {string} */
function number(value) {
  if (typeof value !== "number" || Number.isInteger(value)) return JSON.stringify(value);
  return String(Number(value.toPrecision(7)));
}

/** A value as rows of a name and a text: the fields of a message with their units, or what is in an object. @param {any} value @returns {string[][]} */
function rowsOf(value) {
  const isMessage = value && value.fields && value.units;
  const object = isMessage ? value.fields : value;
  if (object === null || typeof object !== "object" || Array.isArray(object)) return [["", JSON.stringify(value)]];
  return Object.entries(object).map(([name, part]) => {
    const text = typeof part === "string" ? part : Array.isArray(part) ? `[${part.map(number).join(", ")}]` : number(part);
    const unit = isMessage && value.units[name] ? ` ${value.units[name]}` : "";
    return [name, (text ?? "").slice(0, 300) + unit];
  });
}

export class Explorer {
  constructor() {
    /** @type {Link | null} its own, once it is used: what a person ends here must not end what the page reads */
    this.link = null;
    /** @type {Map<string, Entry>} */
    this.keys = new Map();
    /** @type {Map<string, string>} what a person typed, by the key expression it stands for */
    this.own = new Map();
    /** @type {string | null} what was asked for and is not answered yet */
    this.asked = null;
    this.list = byId("subscriptions");
    this.values = byId("values");
    this.trouble = byId("trouble");
    this.field = byId("key");
    byId("subscribe").addEventListener("submit", (/** @type {Event} */ event) => {
      event.preventDefault();
      this.ask(this.field.value.trim());
    });
    for (const button of document.querySelectorAll("#examples button")) {
      button.addEventListener("click", () => this.ask((this.field.value = button.textContent)));
    }
  }

  /** @param {string | null} text */
  ask(text) {
    if (!text) return;
    this.say("");
    this.asked = text;
    this.link = this.link || new Link((message) => (message.key === undefined ? this.told(message) : this.take(message)), () => {});
    this.link.subscribe(text, { hz: Number(byId("hz").value) || 2 });
  }

  /** @param {string} text */
  say(text) {
    this.trouble.textContent = text;
    this.trouble.hidden = !text;
  }

  /** The gateway's words on what was asked. @param {any} message */
  told(message) {
    if (message.subscribed && this.asked && !this.own.has(message.subscribed)) {
      this.add(message.subscribed, this.asked);
      this.asked = null;
    }
    if (message.error) {
      if (this.asked) this.link?.wanted.delete(this.asked);
      this.asked = null;
      this.say(message.error.text);
    }
  }

  /** @param {string} expression @param {string} text */
  add(expression, text) {
    const remove = makeButton("×", "plain", null, t("explore.stop", { key: text }));
    const chip = make("li", "chip", text, remove);
    remove.addEventListener("click", () => {
      this.link?.unsubscribe(text);
      this.own.delete(expression);
      chip.remove();
      for (const [key, entry] of this.keys) {
        if (![...this.own.keys()].some((other) => takes(other, key))) {
          entry.element.remove();
          this.keys.delete(key);
        }
      }
    });
    this.own.set(expression, text);
    this.list.append(chip);
  }

  /** @param {Message} message */
  take(message) {
    if (!this.own.size || ![...this.own.keys()].some((expression) => takes(expression, message.key))) return;
    let entry = this.keys.get(message.key);
    if (!entry) {
      if (this.keys.size >= MOST_SHOWN) return this.say(t("explore.many", { most: MOST_SHOWN }));
      entry = this.enter(message.key);
    }
    entry.times.push(Date.now());
    if (entry.times.length > 20) entry.times.shift();
    entry.value = message.value;
    entry.fresh = true;
  }

  /** @param {string} key @returns {Entry} */
  enter(key) {
    const rate = make("span", "muted");
    const head = make("summary", "", "", make("code", "", key), rate);
    const table = make("table");
    const element = make("details", "value", "", head, table);
    /** @type {Entry} */
    const entry = { key, element, table, rate, times: [], value: null, fresh: true };
    element.open = this.keys.size < 6;
    element.dataset.key = key;
    const after = [...this.keys.values()].filter((other) => other.key > key).sort((a, b) => (a.key < b.key ? -1 : 1))[0];
    this.values.insertBefore(element, after ? after.element : null);
    this.keys.set(key, entry);
    return entry;
  }

  draw() {
    const now = Date.now();
    for (const entry of this.keys.values()) {
      const times = entry.times;
      const last = times[times.length - 1];
      const rate = times.length > 1 ? (1000 * (times.length - 1)) / (last - times[0] || 1) : 0;
      const age = (now - last) / 1000;
      entry.rate.textContent = age > 3 ? t("ago", { span: span(age) }) : rate ? `${rate.toFixed(1)} Hz` : "";
      if (!entry.fresh || !entry.element.open) continue;
      entry.fresh = false;
      entry.table.replaceChildren(...rowsOf(entry.value).map(([name, text]) => make("tr", "", "", make("th", "", name), make("td", "", text))));
    }
  }
}
