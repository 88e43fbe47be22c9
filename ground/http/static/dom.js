// What every view is made of: elements, buttons, what is said aside, and what the browser keeps.

import { t } from "./words.js";

/** The element of that id. @param {string} id @returns {any} */
export const byId = (id) => document.getElementById(id);

/**
 * A new element with a class, a text and children; text is never markup.
 * @param {string} tag @param {string} className @param {string} text @param {...(Node|string)} children @returns {any}
 */
export function make(tag, className = "", text = "", ...children) {
  const element = document.createElement(tag);
  if (className) element.className = className;
  if (text) element.textContent = text;
  element.append(...children);
  return element;
}

/** @param {string} label @param {string} className @param {((press: MouseEvent) => void) | null} act @returns {HTMLButtonElement} */
export function makeButton(label, className, act, title = "") {
  const made = make("button", className, label);
  made.type = "button";
  if (title) made.title = title;
  if (act) made.addEventListener("click", act);
  return made;
}

const SOON_MS = 500; // within which a second press is a double click's, as most systems take it
let downAt = -Infinity;
document.addEventListener("pointerdown", (event) => (downAt = event.timeStamp), true);

/**
 * Whether a press can be meant for what appeared at that time (performance.now()): it did not come at once, as the second one
 * of a double click does, and its pointer went down after that. It goes by time alone and not by the browser's count of clicks: who
 * presses again and again is heard. @param {UIEvent} press @param {number} appeared
 */
export const meant = (press, appeared) => press.timeStamp - appeared >= SOON_MS && (press.detail === 0 || downAt >= appeared); // detail 0: by a key

/** Say something where it is not said already: the page is drawn five times a second. @param {Node} element @param {string} text */
export function say(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** @param {Element} element @param {string} name @param {string} text */
export function mark(element, name, text) {
  if (element.getAttribute(name) !== text) element.setAttribute(name, text);
}

/** Put the texts into a document that names them: data-text, data-title, data-label, data-placeholder. */
export function fillIn() {
  for (const element of document.querySelectorAll("[data-text], [data-title], [data-label], [data-placeholder]")) {
    const { text, title, label, placeholder } = /** @type {Record<string, import("./words.js").TextKey>} */ (/** @type {HTMLElement} */ (element).dataset);
    if (text) element.textContent = t(text);
    if (title) element.setAttribute("title", t(title));
    if (label) element.setAttribute("aria-label", t(label));
    if (placeholder) element.setAttribute("placeholder", t(placeholder));
  }
}

/** A word in the corner. @param {string} text @param {string} kind @param {number} lasting ms; 0: until it is removed */
export function toast(text, kind, lasting = 6000) {
  const box = make("div", `toast ${kind}`, text);
  const boxes = byId("toasts");
  boxes.append(box);
  boxes.scrollTop = boxes.scrollHeight;
  if (lasting) setTimeout(() => box.remove(), lasting);
  return box;
}

/** A colour that differs from that of the vehicles before and after it. @param {number} index */
export const hue = (index) => `hsl(${Math.round((index * 137.5 + 210) % 360)} 75% 48%)`;

/** What this browser keeps under a name; some keep nothing. @param {string} name @param {any} fallback @returns {any} */
export function kept(name, fallback) {
  try {
    return JSON.parse(localStorage.getItem(`zmav ${name}`) ?? "null") ?? fallback;
  } catch (error) {
    return fallback;
  }
}

/** @param {string} name @param {any} value */
export function keep(name, value) {
  try {
    localStorage.setItem(`zmav ${name}`, JSON.stringify(value));
  } catch (error) {
    toast(t("keeps-nothing"), "warn");
  }
}

/** Have the browser save a text. @param {string} name @param {string} text */
export function saveFile(name, text) {
  const link = make("a");
  link.href = URL.createObjectURL(new Blob([text], { type: "application/octet-stream" }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}
