// Keys that mean the same anywhere on the page, but where a person types.

import { byId } from "./dom.js";

/** What each key presses, or goes to. @type {Record<string, string>} */
const PRESSED = { a: "select-all", f: "fit", m: "measure", b: "box" };

/** @param {import("./store.js").Store} store @param {import("./map.js").FleetMap} map */
export function wireKeys(store, map) {
  document.addEventListener("keydown", (event) => {
    const target = /** @type {HTMLElement} */ (event.target);
    if (byId("confirm").open) return;
    if (event.key === "Escape") {
      if (map.tool) map.end();
      else if (target.id === "filter" && byId("filter").value) byId("filter").value = "";
      else store.select([]);
    }
    if (target.matches("input, select, textarea") || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === "/") byId("filter").focus();
    else if (event.key in PRESSED) byId(PRESSED[event.key]).click();
    else return;
    event.preventDefault();
  });
}
