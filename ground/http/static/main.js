// The page as a whole: the socket writes to the store, and every view is drawn from it five times a second.

import { Alarms } from "./alarms.js";
import { OrderBar } from "./bar.js";
import { Cards } from "./cards.js";
import { byId, fillIn, say } from "./dom.js";
import { Drawing } from "./drawing.js";
import { Events } from "./events.js";
import { Explorer } from "./explore.js";
import { FleetLayer } from "./fleetlayer.js";
import { Goals } from "./goals.js";
import { Heights } from "./heights.js";
import { showGround } from "./ground.js";
import { wireKeys } from "./keyboard.js";
import { Link } from "./link.js";
import { FleetMap } from "./map.js";
import { MapTools } from "./maptools.js";
import { Missions } from "./missions.js";
import { allowOrders } from "./orders.js";
import { PlanLayer } from "./planlayer.js";
import { Preflight } from "./preflight.js";
import { Scrubber } from "./scrub.js";
import { Replay } from "./replay.js";
import { address, FLEET, REPLAY } from "./settings.js";
import { Sounds } from "./sounds.js";
import { Store } from "./store.js";
import { FleetTable } from "./table.js";
import { wireTabs } from "./tabs.js";
import { Teams } from "./teams.js";
import { TrafficLayer } from "./traffic.js";
import { wireTheme } from "./theme.js";
import { span, t } from "./words.js";

const DRAW_MS = 200;
const REPORT_MS = 1000;

fillIn();
export const store = new Store();
export const link = new Link(
  (message) => {
    if (message.key !== undefined) store.take(message);
  },
  (state, heard) => {
    store.connection = state;
    store.lastWord = heard;
  },
);
export const map = new FleetMap(store, byId("map"), byId("map-note"));
new MapTools(store, map);
showGround(map);
export const plans = new PlanLayer(store, map);
export const drawing = new Drawing(store, map, plans);
const alarms = new Alarms(store);
export const scrubber = new Scrubber(store, map, plans);
export const heights = new Heights(store, map, plans, scrubber);
export const fleetLayer = new FleetLayer(store, map);
new Missions(store, map);
new Replay(store);
const teams = new Teams(store, map, plans);
const views = [map, teams, new FleetTable(store), fleetLayer, new TrafficLayer(store, map), plans, drawing, scrubber, heights, alarms, new Sounds(store, alarms), new Goals(store), new Preflight(store), new OrderBar(store, map, plans), new Cards(store, link, map), new Events(store), new Explorer()];

function drawLink() {
  const lost = store.connection === "lost";
  document.body.classList.toggle("lost", lost);
  const pill = byId("link");
  pill.className = `pill ${store.connection === "live" ? "good" : lost ? "hot" : ""}`;
  const live = link.rtt === null ? t("link.live") : t("link.rtt", { ms: link.rtt });
  say(pill, store.connection === "live" ? live : lost ? t("link.lost") : t("link.connecting"));
  byId("lost").hidden = !lost;
  if (!lost) return;
  const since = store.lastWord ? t("lost.age", { span: span((Date.now() - store.lastWord) / 1000) }) : "";
  say(byId("lost"), t("lost", { since }));
}

function drawSummary() {
  const all = store.all;
  if (!all.length) return;
  const stale = all.filter((vehicle) => vehicle.stale).length;
  const parts = [t("summary.vehicles", { count: all.length }), t("summary.armed", { count: all.filter((vehicle) => vehicle.state.armed).length })];
  if (stale && store.connection === "live") parts.push(t("summary.silent", { count: stale }));
  for (const [host, base] of store.sources) parts.push(t("summary.base", { host, state: base.state, text: base.text }));
  say(byId("summary"), parts.join(" · "));
  const title = `${REPLAY ? `${t("replay.mark")} · ` : ""}${stale || store.connection === "lost" ? "⚠ " : ""}zmav · ${parts[0]}`;
  if (document.title !== title) document.title = title;
}

/** What spoils one view spoils no other: orders above all must name those whom they are for now. @param {{draw: () => void}} view */
function drawOne(view) {
  try {
    view.draw();
  } catch (error) {
    console.error(error);
  }
}

function draw() {
  drawLink();
  drawSummary();
  for (const view of views) drawOne(view);
  allowOrders(store.connection === "live");
}

async function readReport() {
  if (store.connection !== "live" || document.hidden) return;
  let report = { links: [], vehicles: [], aircraft: [] }; // what was known before is no longer known where none comes
  try {
    const answer = await fetch(address("report"), { signal: AbortSignal.timeout(5 * REPORT_MS) });
    if (answer.ok) report = await answer.json();
  } catch (error) {
    // The WebSocket says that the gateway is lost.
  }
  store.takeReport(report);
}

/** Where the autopilot of each selected one flies to: asked for while it is selected. @type {Set<string>} */
let aimed = new Set();
function readTargets() {
  const wanted = new Set(store.chosen.slice(0, 8).map((vehicle) => `zmav/${vehicle.id}/mav/rx/*/*/POSITION_TARGET_GLOBAL_INT`));
  for (const key of aimed) if (!wanted.has(key)) link.unsubscribe(key);
  for (const key of wanted) if (!aimed.has(key)) link.subscribe(key, { hz: 1 });
  aimed = wanted;
  for (const vehicle of store.all) if (!store.selected.has(vehicle.id)) vehicle.target = null;
}

wireTabs();
wireKeys(store, map);
wireTheme(() => map.paint());
for (const anchor of document.querySelectorAll("footer a")) /** @type {HTMLAnchorElement} */ (anchor).href = address(anchor.getAttribute("href") || "");
link.subscribe("*", { hz: 5, changes: true });
link.subscribe("*/event", { history: 10 });
for (const topic of ["charge", "goal", "plan", "obstacle"]) link.subscribe(`zmav/${FLEET}/@fleet/${topic}`, { hz: 2 });
link.subscribe(`zmav/${FLEET}/@obstacle/*`, { hz: 2 });
for (const kind of ["camera", "video"]) link.subscribe(`*/agent/${kind}-*/status`, { hz: 2 });
link.subscribe("*/agent/rtk/status", { hz: 1 });
link.subscribe("*/HOME_POSITION", { hz: 0.1 });
store.changed = draw;
setInterval(draw, DRAW_MS);
setInterval(readReport, REPORT_MS);
setInterval(readTargets, REPORT_MS);
draw();
