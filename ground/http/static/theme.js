// Light, dark, or with high contrast for the sun: as the system is set, or as a person chose here.

import { byId, keep, kept } from "./dom.js";
import { t } from "./words.js";

const DARK = matchMedia("(prefers-color-scheme: dark)");
const CONTRAST = matchMedia("(prefers-contrast: more)");

const ofSystem = () => (CONTRAST.matches ? "contrast" : DARK.matches ? "dark" : "light");

/** @param {() => void} changed what is drawn by hand is to be drawn again */
export function followTheme(changed = () => {}) {
  const chosen = kept("theme", "system");
  document.documentElement.dataset.theme = chosen === "system" ? ofSystem() : chosen;
  changed();
  DARK.onchange = CONTRAST.onchange = () => followTheme(changed);
}

/** @param {() => void} changed */
export function wireTheme(changed) {
  const select = byId("theme");
  for (const [value, word] of [["system", t("theme.system")], ["light", t("theme.light")], ["dark", t("theme.dark")], ["contrast", t("theme.contrast")]]) select.append(new Option(word, value));
  select.value = kept("theme", "system");
  select.addEventListener("change", () => {
    keep("theme", select.value);
    followTheme(changed);
  });
  followTheme(changed);
}
