// Keys that mean the same anywhere on the page, but where a person types; "?" lists them.

import { byId, make } from "./dom.js";
import { t } from "./words.js";

/** What each key presses. @type {Record<string, string>} */
const PRESSED = { a: "select-all", f: "fit", m: "measure", b: "box", h: "heights-button", "?": "keys-button" };

function listKeys() {
  const rows = [["/", t("key.filter")], ["A", t("key.all")], [t("keys.esc"), t("key.esc")], ["↑ ↓", t("key.rows")], ["␣", t("key.space")], ["↵", t("key.enter")], ["F", t("key.fit")], ["H", t("key.heights")], ["M", t("key.measure")], ["B", t("key.box")], ["+ −", t("key.zoom")], ["← →", t("key.tabs")], [t("keys.del"), t("key.delete")], [t("keys.undo"), t("key.undo")], ["?", t("key.help")]];
  byId("keys-list").replaceChildren(...rows.map(([key, text]) => make("tr", "", "", make("th", "", "", make("kbd", "", key)), make("td", "", text))));
  byId("keys-button").addEventListener("click", () => byId("keys").showModal());
}

/** @param {import("./store.js").Store} store @param {import("./map.js").FleetMap} map */
export function wireKeys(store, map) {
  listKeys();
  document.addEventListener("keydown", (event) => {
    const target = /** @type {HTMLElement} */ (event.target);
    if (document.querySelector("dialog:modal") || target.closest("dialog")) return;
    if (event.key === "Escape") {
      if (map.tool) map.end();
      else if (target.id === "filter" && byId("filter").value) byId("filter").value = "";
      else store.select([]);
    }
    if (target.matches("input:not([type=range], [type=checkbox]), select, textarea") || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === "/") byId("filter").focus();
    else if (event.key in PRESSED) byId(PRESSED[event.key]).click();
    else return;
    event.preventDefault();
  });
}
