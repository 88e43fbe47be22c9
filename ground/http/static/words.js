// Texts by their keys, numbers and times in words.

import { LANGUAGE, TEXTS } from "./texts.js";

/**
 * @typedef {keyof typeof TEXTS} TextKey
 * @typedef {Record<string, string | number>} Values
 * @typedef {"bad" | "warn" | "note" | "ok"} Level
 */

const plurals = new Intl.PluralRules(LANGUAGE);

/**
 * The text of a key, with values put in where it has their names in braces; one in several numbers goes by "count".
 * @param {TextKey} key @param {Values} values
 */
export function t(key, values = {}) {
  /** @type {string | Record<string, string>} */
  const found = TEXTS[key];
  const text = typeof found === "string" ? found : (found[plurals.select(Number(values.count))] ?? found.other);
  return text.replace(/\{(\w+)\}/g, (whole, name) => (name in values ? String(values[name]) : whole));
}

/** @type {Level[]} the worst first */
export const LEVELS = ["bad", "warn", "note", "ok"];
/** What a level is called on the page. @type {Record<Level, string>} */
export const LEVEL_WORD = { bad: t("level.bad"), warn: t("level.warn"), note: t("level.note"), ok: t("level.ok") };

/** A height of -0.04 m is 0.0, not -0.0. @param {number} value @param {number} digits */
export const fixed = (value, digits) => value.toFixed(digits).replace(/^-(?=0(\.0*)?$)/, "");

/** A dash for what is not known. @param {number | null | undefined} value @param {number} digits */
export const shown = (value, digits, unit = "") => (value === null || value === undefined ? "–" : `${fixed(value, digits)}${unit}`);

/** @param {number} seconds */
export function span(seconds) {
  if (seconds < 10) return `${seconds.toFixed(1)} s`;
  if (seconds < 90) return `${Math.round(seconds)} s`;
  return seconds < 5400 ? `${Math.round(seconds / 60)} min` : `${Math.round(seconds / 3600)} h`;
}

/** @param {number} m */
export const metres = (m) => (m >= 10000 ? `${(m / 1000).toFixed(1)} km` : m >= 100 ? `${Math.round(m)} m` : `${m.toFixed(1)} m`);

/** How old the receiver's corrections are, and how far their base; empty where none come. @param {import("./types.js").State["corrections"]} found */
export function corrected(found) {
  if (!found) return "";
  const age = found.age === null ? t("rtcm.none") : t("rtcm.age", { seconds: found.age < 10 ? found.age.toFixed(1) : String(Math.round(found.age)) });
  return found.baseline === null || found.baseline === undefined ? `${found.source} · ${age}` : `${found.source} · ${age} · ${t("rtcm.far", { km: (found.baseline / 1000).toFixed(1) })}`;
}

/** What the receiver estimates, else how the satellites stand; empty where it says neither. @param {import("./types.js").State["gps"]} gps */
export function accuracy(gps) {
  if (!gps) return "";
  if (gps.h_acc) return t("gps.accuracy", { metres: gps.h_acc < 0.1 ? gps.h_acc.toFixed(2) : gps.h_acc < 10 ? gps.h_acc.toFixed(1) : String(Math.round(gps.h_acc)) });
  return gps.hdop ? t("gps.hdop", { hdop: gps.hdop.toFixed(1) }) : "";
}

/** Radians as whole degrees clockwise from north. @param {number} radians */
export const degrees = (radians) => ((Math.round((radians * 180) / Math.PI) % 360) + 360) % 360;

/** "quad1, quad2 and 3 more". @param {string[]} names */
export const few = (names, most = 4) => (names.length > most ? t("few.more", { names: names.slice(0, most).join(", "), count: names.length - most }) : names.join(", "));

/** A name for a button: a long one is cut. @param {string} name */
export const brief = (name, most = 16) => (name.length > most ? `${name.slice(0, most - 1)}…` : name);

/** What was thrown, in words. @param {unknown} error */
export const wordsOf = (error) => (error instanceof Error ? error.message : String(error));
