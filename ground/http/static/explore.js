"use strict";
// Any key expression, live: the newest value of each key, how fast it comes and how old it is.

const MOST_SHOWN = 200;

// Whether a key expression takes a key in: * is a chunk, ** any number of them, $* any part of one.
function takes(expression, key) {
  const pattern = expression
    .split("/")
    .map((chunk) => (chunk === "**" ? "**" : chunk === "*" ? "[^/@][^/]*" : chunk.replace(/[.+?^{}()|[\]\\]/g, "\\$&").replace(/\$\*/g, "[^/]*")))
    .join("/")
    .replace(/\*\*\/|\/\*\*|\*\*/g, (stars) => (stars.endsWith("/") ? "(?:[^/@][^/]*/)*" : stars.startsWith("/") ? "(?:/[^/@][^/]*)*" : "[^@].*"));
  return new RegExp(`^${pattern}$`).test(key);
}

function number(value) {
  if (typeof value !== "number" || Number.isInteger(value)) return JSON.stringify(value);
  return String(Number(value.toPrecision(7)));
}

// A value as rows of a name and a text: the fields of a message with their units, or what is in an object.
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

class Explorer {
  constructor(link) {
    this.link = link;
    this.keys = new Map();
    this.own = new Map(); // what a person typed, by the key expression it stands for
    this.list = document.getElementById("subscriptions");
    this.values = document.getElementById("values");
    this.trouble = document.getElementById("trouble");
    this.field = byId("key");
    byId("subscribe").addEventListener("submit", (event) => {
      event.preventDefault();
      this.ask(this.field.value.trim());
    });
    for (const button of document.querySelectorAll("#examples button")) {
      button.addEventListener("click", () => this.ask((this.field.value = button.textContent)));
    }
  }

  ask(text) {
    if (!text) return;
    this.say("");
    this.asked = text;
    this.link.subscribe(text, { hz: Number(byId("hz").value) || 2 });
  }

  say(text) {
    this.trouble.textContent = text;
    this.trouble.hidden = !text;
  }

  // The gateway's words on what was asked.
  told(message) {
    if (message.subscribed && this.asked && !this.own.has(message.subscribed) && this.link.wanted.has(this.asked)) {
      this.add(message.subscribed, this.asked);
      this.asked = null;
    }
    if (message.error) {
      if (this.asked) this.link.wanted.delete(this.asked);
      this.asked = null;
      this.say(message.error.text);
    }
  }

  add(expression, text) {
    const remove = make("button", "plain", "×");
    remove.type = "button";
    remove.title = `stop reading ${text}`;
    const chip = make("li", "chip", text, remove);
    remove.addEventListener("click", () => {
      this.link.unsubscribe(text);
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

  take(message) {
    if (!this.own.size || ![...this.own.keys()].some((expression) => takes(expression, message.key))) return;
    let entry = this.keys.get(message.key);
    if (!entry) {
      if (this.keys.size >= MOST_SHOWN) return this.say(`only the first ${MOST_SHOWN} keys are shown: subscribe to fewer`);
      entry = this.enter(message.key);
    }
    entry.times.push(Date.now());
    if (entry.times.length > 20) entry.times.shift();
    entry.value = message.value;
    entry.fresh = true;
  }

  enter(key) {
    const head = make("summary", "", "", make("code", "", key), make("span", "muted"));
    const table = make("table");
    const element = make("details", "value", "", head, table);
    const entry = { key, element, head, table, times: [], value: null, fresh: true };
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
      entry.head.lastChild.textContent = age > 3 ? `${span(age)} ago` : rate ? `${rate.toFixed(1)} Hz` : "";
      if (!entry.fresh || !entry.element.open) continue;
      entry.fresh = false;
      entry.table.replaceChildren(...rowsOf(entry.value).map(([name, text]) => make("tr", "", "", make("th", "", name), make("td", "", text))));
    }
  }
}
