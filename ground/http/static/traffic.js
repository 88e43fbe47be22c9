// Aircraft that are not of the fleet: on the map where they are by now, and in a list, the nearest first.

import { byId, make, say } from "./dom.js";
import { outlineOf } from "./fleetlayer.js";
import { toGlobal } from "./geo.js";
import { L } from "./vendor.js";
import { fixed, t } from "./words.js";

/** @typedef {import("./types.js").Aircraft} Aircraft */

export class TrafficLayer {
  /** @param {import("./store.js").Store} store @param {import("./map.js").FleetMap} view */
  constructor(store, view) {
    this.store = store;
    this.view = view;
    /** @type {Map<string, {marker: any, svg: any}>} by address */
    this.drawn = new Map();
    this.listed = "";
  }

  draw() {
    const there = new Set();
    for (const each of this.store.aircraft) {
      there.add(each.icao);
      this.place(each);
    }
    for (const [icao, { marker }] of this.drawn) {
      if (there.has(icao)) continue;
      marker.remove();
      this.drawn.delete(icao);
    }
    this.list();
  }

  /** @param {Aircraft} each */
  place(each) {
    const [north, east] = each.velocity || [0, 0];
    const age = each.age + (Date.now() - this.store.aircraftAt) / 1000;
    const { lat, lon } = toGlobal({ lat: each.lat_deg, lon: each.lon_deg }, north * age, east * age);
    const drawn = this.drawn.get(each.icao) || this.make(each, lat, lon);
    drawn.marker.setLatLng([lat, lon]);
    drawn.svg.style.transform = `rotate(${Math.atan2(east, north)}rad)`;
    drawn.svg.style.opacity = age > 10 ? "0.5" : "1";
    drawn.marker.setTooltipContent(make("span", "", `${nameOf(each)} ${heightOf(each)}`));
  }

  /** @param {Aircraft} each @param {number} lat @param {number} lon */
  make(each, lat, lon) {
    const { svg } = outlineOf("plane", this.view.colour("--keepout"));
    const icon = L.divIcon({ className: "craft aircraft", html: svg, iconSize: [34, 34] });
    const marker = L.marker([lat, lon], { icon, interactive: false, alt: nameOf(each) }).addTo(this.view.map);
    marker.bindTooltip("", { permanent: true, direction: "right", offset: [14, 0], className: "named" });
    const drawn = { marker, svg };
    this.drawn.set(each.icao, drawn);
    return drawn;
  }

  list() {
    const rows = this.store.aircraft.map((each) => {
      const near = each.distance === null ? "" : t("traffic.near", { km: fixed(each.distance / 1000, 1), vehicle: each.vehicle || "", height: heightOf(each), nearest: String(each.nearest ?? "–"), seconds: String(each.time ?? "–") });
      return [nameOf(each), near, t("traffic.age", { seconds: fixed(each.age, 0), source: each.source })];
    });
    const words = JSON.stringify(rows);
    if (words === this.listed) return;
    this.listed = words;
    byId("traffic").hidden = !rows.length;
    say(byId("traffic-count"), String(rows.length));
    byId("aircraft").replaceChildren(...rows.map(([name, near, age]) => make("li", "", "", make("b", "", name), make("span", "", ` ${near} `), make("span", "muted", age))));
  }
}

/** @param {Aircraft} each */
const nameOf = (each) => each.callsign || each.icao;

/** Above the vehicle that is nearest to it, or above the sea where there is none. @param {Aircraft} each */
function heightOf(each) {
  if (each.height !== null) return t("traffic.above", { metres: `${each.height >= 0 ? "+" : ""}${each.height}` });
  return each.alt_amsl === null ? t("traffic.no-height") : t("traffic.amsl", { metres: String(each.alt_amsl) });
}
