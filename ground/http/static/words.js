"use strict";
// What every view is made of: elements, numbers and times in words, colours of vehicles.

const READ_ONLY = /** @type {HTMLMetaElement} */ (document.querySelector("meta[name=zmav-read-only]")).content === "yes";
const FLEET = /** @type {HTMLMetaElement} */ (document.querySelector("meta[name=zmav-fleet]")).content;
const LEVELS = ["bad", "warn", "note", "ok"];
/** What a level is called on the page. @type {Record<string, string>} */
const LEVEL_WORD = { bad: "act now", warn: "warning", note: "note", ok: "well" };

/** The element of that id. @param {string} id @returns {any} */
const byId = (id) => document.getElementById(id);

/**
 * A new element with a class, a text and children; text is never markup.
 * @param {string} tag @param {string} className @param {string} text @param {...(Node|string)} children @returns {any}
 */
function make(tag, className = "", text = "", ...children) {
  const element = document.createElement(tag);
  if (className) element.className = className;
  if (text) element.textContent = text;
  element.append(...children);
  return element;
}

/** @param {string} label @param {string} className @param {() => void} act @param {string} title */
function makeButton(label, className, act, title = "") {
  const made = make("button", className, label);
  made.type = "button";
  if (title) made.title = title;
  if (act) made.addEventListener("click", act);
  return made;
}

/** Say something where it is not said already: the page is drawn five times a second. @param {any} element @param {string} text */
function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** @param {Element} element @param {string} name @param {string} text */
function mark(element, name, text) {
  if (element.getAttribute(name) !== text) element.setAttribute(name, text);
}

/** A height of -0.04 m is 0.0, not -0.0. @param {number} value @param {number} digits */
const fixed = (value, digits) => value.toFixed(digits).replace(/^-(?=0(\.0*)?$)/, "");
/** A dash for what is not known. @param {number | null | undefined} value @param {number} digits */
const shown = (value, digits, unit = "") => (value === null || value === undefined ? "–" : `${fixed(value, digits)}${unit}`);

/** @param {number} seconds */
function span(seconds) {
  if (seconds < 10) return `${seconds.toFixed(1)} s`;
  if (seconds < 90) return `${Math.round(seconds)} s`;
  return seconds < 5400 ? `${Math.round(seconds / 60)} min` : `${Math.round(seconds / 3600)} h`;
}

/** @param {number} m */
const metres = (m) => (m >= 10000 ? `${(m / 1000).toFixed(1)} km` : m >= 100 ? `${Math.round(m)} m` : `${m.toFixed(1)} m`);

/** "quad1, quad2 and 3 more". @param {string[]} names */
const few = (names, most = 4) => (names.length > most ? `${names.slice(0, most).join(", ")} and ${names.length - most} more` : names.join(", "));

/** A colour that differs from that of the vehicles before and after it. @param {number} index */
const hue = (index) => `hsl(${Math.round((index * 137.5 + 210) % 360)} 75% 48%)`;

/** What this browser keeps under a name; some keep nothing. @param {string} name @returns {any} */
function kept(name, fallback) {
  try {
    return JSON.parse(localStorage.getItem(`zmav ${name}`)) ?? fallback;
  } catch (error) {
    return fallback;
  }
}

/** @param {string} name @param {any} value */
function keep(name, value) {
  try {
    localStorage.setItem(`zmav ${name}`, JSON.stringify(value));
  } catch (error) {
    toast("This browser keeps nothing: it is forgotten with the page", "warn");
  }
}
