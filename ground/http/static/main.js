"use strict";
// The page as a whole: who is there, whether we are connected, and what is drawn when.

const DRAW_MS = 200;
const MOST_EVENTS = 100;
const MOST_CARDS = 500;
const SEVERE = new Set(["emergency", "alert", "critical", "error"]);
const cards = new Map();
const banner = document.getElementById("lost");
const pill = document.getElementById("link");
const events = document.getElementById("events");
let eventCount = 0;
let lastWord = 0;
let connection = "connecting";

function onMessage(message) {
  if (message.key === undefined) return explorer.told(message);
  const chunks = message.key.split("/");
  if (chunks.length === 4 && chunks[3] === "state") onState(chunks[1], chunks[2], message.value, message.alarms);
  else if (chunks.length === 4 && chunks[3] === "event") onEvent(chunks[2], message.value);
  explorer.take(message);
}

function onState(fleet, name, state, alarms) {
  if (!state || typeof state !== "object") return;
  const id = `${fleet}/${name}`;
  let card = cards.get(id);
  if (!card) {
    if (cards.size >= MOST_CARDS) return;
    card = new Card(fleet, name);
    cards.set(id, card);
    const after = [...cards.keys()].sort()[[...cards.keys()].sort().indexOf(id) + 1];
    document.getElementById("fleet").insertBefore(card.element, after ? cards.get(after).element : null);
    document.getElementById("nobody").hidden = true;
    document.getElementById("everybody").hidden = READ_ONLY;
  }
  card.take(state, alarms);
}

function onEvent(name, event) {
  if (!event || typeof event.text !== "string") return;
  const same = [...events.children].some((item) => item.dataset.t === String(event.t) && item.lastChild.textContent === event.text);
  if (same) return; // what was heard before the connection was lost
  if (!eventCount++) events.replaceChildren();
  const when = new Date(event.t * 1000).toLocaleTimeString([], { hour12: false });
  const kind = SEVERE.has(event.severity) ? "bad" : event.severity === "warning" ? "warn" : "";
  const item = make("li", kind, "", make("time", "", when), make("b", "", name), make("span", "", event.text));
  item.dataset.t = event.t;
  events.insertBefore(item, [...events.children].find((other) => Number(other.dataset.t) <= event.t) || null);
  while (events.children.length > MOST_EVENTS) events.lastChild.remove();
  document.getElementById("event-count").textContent = `${eventCount} so far`;
}

function onLink(state, heard) {
  connection = state;
  lastWord = heard;
}

function drawLink() {
  const lost = connection === "lost";
  document.body.classList.toggle("lost", lost);
  pill.className = `pill ${connection === "live" ? "good" : lost ? "hot" : ""}`;
  pill.textContent = connection === "live" ? (link.rtt === null ? "live" : `live · ${link.rtt} ms`) : lost ? "CONNECTION LOST" : "connecting";
  banner.hidden = !lost;
  if (!lost) return;
  const since = lastWord ? ` What you see is ${span((Date.now() - lastWord) / 1000)} old.` : "";
  banner.textContent = `Connection to the gateway lost.${since} Trying again; the vehicles fly on by themselves.`;
}

function draw() {
  drawLink();
  const all = [...cards.values()];
  for (const card of all) card.drawSafely();
  const count = (true_) => all.filter(true_).length;
  const stale = count((card) => card.stale);
  if (all.length) {
    const parts = [`${all.length} vehicle${all.length > 1 ? "s" : ""}`, `${count((card) => card.state.armed)} armed`];
    if (stale && connection === "live") parts.push(`${stale} silent`);
    document.getElementById("summary").textContent = parts.join(" · ");
    document.title = `${stale || connection === "lost" ? "⚠ " : ""}zmav · ${all.length} vehicles`;
  }
  for (const button of document.querySelectorAll(".orders button[type=button]")) button.disabled = connection !== "live";
  map.draw(all);
  explorer.draw();
}

const link = new Link(onMessage, onLink);
const explorer = new Explorer(link);
const map = new FleetMap(document.getElementById("map"), document.getElementById("map-note"));
for (const button of document.querySelectorAll("#everybody button")) armTwice(button, () => order(["*"], button.dataset.verb));
for (const anchor of document.querySelectorAll("footer a")) anchor.href = address(anchor.getAttribute("href"));
link.subscribe("*", { hz: 5 });
link.subscribe("*/event", { history: 10 });
setInterval(draw, DRAW_MS);
draw();
