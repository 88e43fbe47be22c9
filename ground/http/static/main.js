"use strict";
// The page as a whole: the socket writes to the store, and every view is drawn from it five times a second.

const DRAW_MS = 200;
const REPORT_MS = 1000;
const SEVERE = new Set(["emergency", "alert", "critical", "error"]);
/** @type {Map<string, Card>} of the selected */
const cards = new Map();
const MOST_CARDS = 12;

const store = new Store();
const link = new Link(
  (message) => {
    if (message.key === undefined) return explorer.told(message);
    store.take(message);
    explorer.take(message);
  },
  (state, heard) => {
    store.connection = state;
    store.lastWord = heard;
  },
);
const explorer = new Explorer(link);
const map = new FleetMap(store, byId("map"), byId("map-note"));
const tools = new MapTools(store, map);
showGround(map);
const plans = new PlanLayer(store, map);
const drawing = new Drawing(store, map, plans);
const views = [new FleetTable(store), new FleetLayer(store, map), plans, new Alarms(store), new Goals(store), new Preflight(store), new OrderBar(store, map, plans)];

function drawLink() {
  const lost = store.connection === "lost";
  document.body.classList.toggle("lost", lost);
  const pill = byId("link");
  pill.className = `pill ${store.connection === "live" ? "good" : lost ? "hot" : ""}`;
  say(pill, store.connection === "live" ? (link.rtt === null ? "live" : `live · ${link.rtt} ms`) : lost ? "CONNECTION LOST" : "connecting");
  byId("lost").hidden = !lost;
  if (!lost) return;
  const since = store.lastWord ? ` What you see is ${span((Date.now() - store.lastWord) / 1000)} old.` : "";
  say(byId("lost"), `Connection to the gateway lost.${since} Trying again; the vehicles fly on by themselves.`);
}

function drawSummary() {
  const all = store.all;
  if (!all.length) return;
  const stale = all.filter((vehicle) => vehicle.stale).length;
  const parts = [`${all.length} vehicle${all.length > 1 ? "s" : ""}`, `${all.filter((vehicle) => vehicle.state.armed).length} armed`];
  if (stale && store.connection === "live") parts.push(`${stale} silent`);
  say(byId("summary"), parts.join(" · "));
  const title = `${stale || store.connection === "lost" ? "⚠ " : ""}zmav · ${all.length} vehicles`;
  if (document.title !== title) document.title = title;
}

function drawCards() {
  const wanted = store.chosen.slice(0, MOST_CARDS);
  const ids = new Set(wanted.map((vehicle) => vehicle.id));
  for (const [id, card] of cards) {
    if (ids.has(id)) continue;
    card.element.remove();
    cards.delete(id);
  }
  wanted.forEach((vehicle, index) => {
    let card = cards.get(vehicle.id);
    if (!card) cards.set(vehicle.id, (card = new Card(vehicle)));
    const place = byId("fleet").children[index];
    if (place !== card.element) byId("fleet").insertBefore(card.element, place || null);
    card.drawSafely();
  });
}

let eventsDrawn = -1;
function drawEvents() {
  if (store.eventCount === eventsDrawn) return;
  eventsDrawn = store.eventCount;
  if (!store.eventCount) return;
  say(byId("event-count"), String(store.eventCount));
  byId("events").replaceChildren(
    ...store.events.map((event) => {
      const when = new Date(event.t * 1000).toLocaleTimeString([], { hour12: false });
      const kind = SEVERE.has(event.severity) ? "bad" : event.severity === "warning" ? "warn" : "";
      return make("li", kind, "", make("time", "", when), make("b", "", event.name), make("span", "", event.text));
    }),
  );
}

function draw() {
  drawLink();
  drawSummary();
  map.draw();
  for (const view of views) view.draw();
  drawCards();
  drawEvents();
  const orders = document.querySelectorAll(".card .orders button, #bar button[data-verb], #goals .orders button");
  for (const button of orders) /** @type {HTMLButtonElement} */ (button).disabled = store.connection !== "live";
  explorer.draw();
}

/** @param {string} name */
function showTab(name) {
  for (const tab of document.querySelectorAll("[role=tab]")) {
    const on = /** @type {HTMLElement} */ (tab).dataset.tab === name;
    tab.setAttribute("aria-selected", String(on));
    /** @type {HTMLElement} */ (tab).tabIndex = on ? 0 : -1;
    byId(/** @type {HTMLElement} */ (tab).dataset.tab).hidden = !on;
  }
}

async function readReport() {
  if (store.connection !== "live" || document.hidden) return;
  try {
    const answer = await fetch(address("report"));
    if (answer.ok) store.takeReport(await answer.json());
  } catch (error) {
    // The WebSocket says that the gateway is lost.
  }
}

/** Where the autopilot of each selected one flies to: asked for while it is selected. */
let aimed = new Set();
function readTargets() {
  const wanted = new Set(store.chosen.slice(0, 8).map((vehicle) => `zmav/${vehicle.id}/mav/rx/*/*/POSITION_TARGET_GLOBAL_INT`));
  for (const key of aimed) if (!wanted.has(key)) link.unsubscribe(key);
  for (const key of wanted) if (!aimed.has(key)) link.subscribe(key, { hz: 1 });
  aimed = wanted;
  for (const vehicle of store.all) if (!store.selected.has(vehicle.id)) vehicle.target = null;
}

const KEYS = { "/": () => byId("filter").focus(), a: () => byId("select-all").click(), f: () => byId("fit").click(), m: () => byId("measure").click(), b: () => byId("box").click() };
document.addEventListener("keydown", (event) => {
  const target = /** @type {HTMLElement} */ (event.target);
  if (byId("confirm").open) return;
  if (event.key === "Escape") {
    if (map.tool) map.end();
    else if (target.id === "filter" && byId("filter").value) byId("filter").value = "";
    else store.select([]);
  }
  if (target.matches("input, select, textarea") || event.ctrlKey || event.metaKey || event.altKey || !KEYS[event.key]) return;
  event.preventDefault();
  KEYS[event.key]();
});
for (const tab of document.querySelectorAll("[role=tab]")) {
  tab.addEventListener("click", () => showTab(/** @type {HTMLElement} */ (tab).dataset.tab));
  tab.addEventListener("keydown", (event) => {
    const step = { ArrowRight: "nextElementSibling", ArrowLeft: "previousElementSibling" }[/** @type {KeyboardEvent} */ (event).key];
    const next = step && /** @type {any} */ (tab)[step];
    if (!next) return;
    next.focus();
    next.click();
  });
}
for (const anchor of document.querySelectorAll("footer a")) /** @type {HTMLAnchorElement} */ (anchor).href = address(anchor.getAttribute("href"));
link.subscribe("*", { hz: 5 });
link.subscribe("*/event", { history: 10 });
link.subscribe(`zmav/${FLEET}/@fleet/*`, { hz: 2 });
link.subscribe(`zmav/${FLEET}/@obstacle/*`, { hz: 2 });
link.subscribe("*/HOME_POSITION", { hz: 0.1 });
store.changed = draw;
setInterval(draw, DRAW_MS);
setInterval(readReport, REPORT_MS);
setInterval(readTargets, REPORT_MS);
draw();
