// Missions and fences that are on the selected vehicles, shown on the map; files of them read, shown and uploaded.

import { confirmed } from "./ask.js";
import { byId, make, makeButton, toast } from "./dom.js";
import { postText } from "./orders.js";
import { address, READ_ONLY } from "./settings.js";
import { L } from "./vendor.js";
import { few, t, wordsOf } from "./words.js";

/** @typedef {{command: string, frame: string, x: number, y: number, z: number}} Item */
/** @typedef {Record<string, Item[]>} Plans by kind: mission, fence, rally */

const KINDS = ["mission", "fence", "rally"];

export class Missions {
  /** @param {import("./store.js").Store} store @param {import("./map.js").FleetMap} view */
  constructor(store, view) {
    this.store = store;
    this.view = view;
    this.layer = L.layerGroup().addTo(view.map);
    this.list = make("ul", "missions");
    const box = make("section", "", "", make("h3", "", t("missions")));
    const buttons = make("div", "orders", "", makeButton(t("missions.show"), "small", () => this.read(), t("missions.show.title")), makeButton(t("missions.hide"), "small", () => this.clear()));
    this.input = make("input");
    Object.assign(this.input, { type: "file", accept: ".plan,.waypoints,.txt", id: "mission-file" });
    this.input.setAttribute("aria-label", t("missions.file"));
    this.input.addEventListener("change", () => this.open());
    if (!READ_ONLY) buttons.append(make("label", "", `${t("missions.file")} `, this.input));
    box.append(buttons, this.list);
    byId("drawing").append(box);
  }

  clear() {
    this.layer.clearLayers();
    this.list.replaceChildren();
  }

  /** What is on each of the selected, by its companion's cache. */
  async read() {
    this.clear();
    const chosen = this.store.chosen;
    if (!chosen.length) return toast(t("missions.who"), "bad");
    await Promise.all(chosen.map((vehicle) => this.readOne(vehicle)));
  }

  /** @param {import("./vehicle.js").Vehicle} vehicle */
  async readOne(vehicle) {
    try {
      const answer = await fetch(address(`keys/zmav/${vehicle.id}/mission/*`));
      const found = await answer.json();
      if (!answer.ok) throw new Error(found.error.text);
      /** @type {Plans} */
      const plans = {};
      for (const each of found) if (each.value) plans[each.value.kind] = each.value.items;
      this.draw(plans, vehicle.colour);
      this.list.append(make("li", "", t("missions.on", { name: vehicle.name, what: this.countOf(plans) })));
    } catch (error) {
      this.list.append(make("li", "", t("missions.on", { name: vehicle.name, what: wordsOf(error) })));
    }
  }

  /** @param {Plans} plans */
  countOf(plans) {
    return KINDS.map((kind) => `${(plans[kind] || []).length} ${kind}`).join(", ");
  }

  /** @param {Plans} plans @param {string} colour */
  draw(plans, colour) {
    for (const kind of KINDS) {
      const items = (plans[kind] || []).filter((item) => /GLOBAL/.test(item.frame) && (item.x || item.y));
      const corners = items.map((item) => /** @type {[number, number]} */ ([item.x, item.y]));
      const style = { color: kind === "fence" ? this.view.colour("--fence") : colour, weight: 2, dashArray: kind === "fence" ? "12 6" : "2 5", interactive: false };
      if (kind === "mission") L.polyline(corners, style).addTo(this.layer);
      if (kind === "fence") for (const ring of ringsOf(items)) L.polygon(ring, { ...style, fillOpacity: 0 }).addTo(this.layer);
      if (kind !== "fence") corners.forEach((corner, index) => L.circleMarker(corner, { ...style, radius: 4 }).bindTooltip(make("span", "", `${kind === "rally" ? "R" : ""}${index + 1}`), { permanent: true, className: "named" }).addTo(this.layer));
    }
  }

  /** Read a file, show it, and upload it to the selected if a person agrees. */
  async open() {
    const file = this.input.files[0];
    if (!file) return;
    this.input.value = "";
    const vehicles = this.store.chosen;
    try {
      const body = await file.text();
      const plans = await postText("mission/read", body);
      this.clear();
      this.draw(plans, this.view.colour("--accent"));
      const what = this.countOf(plans);
      this.list.append(make("li", "", t("missions.on", { name: file.name, what })));
      if (!vehicles.length) return toast(t("missions.who"), "bad");
      const who = few(vehicles.map((each) => each.name), 8);
      if (!(await confirmed(t("missions.title", { name: file.name, who }), t("missions.text", { what }), t("missions.yes")))) return;
      const told = await postText(`mission/upload?vehicles=${vehicles.map((each) => encodeURIComponent(each.id)).join(",")}`, body);
      for (const each of told.vehicles) toast(`${each.vehicle}: ${each.text}`, each.status === "done" ? "good" : "bad", 10000);
    } catch (error) {
      toast(t("missions.failed", { name: file.name, text: wordsOf(error) }), "bad", 15000);
    }
  }
}

/** Polygons of a fence: each corner says how many its polygon has. @param {any[]} items @returns {[number, number][][]} */
export function ringsOf(items) {
  const rings = [];
  for (let at = 0; at < items.length; ) {
    const count = /POLYGON_VERTEX/.test(items[at].command) ? Number((items[at].params || [])[0]) || 1 : 1;
    const ring = items.slice(at, at + count).map((item) => /** @type {[number, number]} */ ([item.x, item.y]));
    if (ring.length > 2) rings.push(ring);
    at += count;
  }
  return rings;
}
