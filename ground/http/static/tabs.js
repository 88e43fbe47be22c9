// The panel's tabs: alarms, goals, preflight, what is drawn, events.

import { byId } from "./dom.js";

const tabs = () => /** @type {HTMLElement[]} */ ([...document.querySelectorAll("[role=tab]")]);

/** @param {string} name */
export function showTab(name) {
  for (const tab of tabs()) {
    const on = tab.dataset.tab === name;
    tab.setAttribute("aria-selected", String(on));
    tab.tabIndex = on ? 0 : -1;
    byId(tab.dataset.tab || "").hidden = !on;
  }
}

export function wireTabs() {
  for (const tab of tabs()) {
    tab.addEventListener("click", () => showTab(tab.dataset.tab || ""));
    tab.addEventListener("keydown", (event) => {
      const next = event.key === "ArrowRight" ? tab.nextElementSibling : event.key === "ArrowLeft" ? tab.previousElementSibling : null;
      if (!(next instanceof HTMLElement)) return;
      next.focus();
      next.click();
    });
  }
}
