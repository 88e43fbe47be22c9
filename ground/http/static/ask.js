// One question at a time, before what arms or moves.

import { byId, make, meant, toast } from "./dom.js";
import { t } from "./words.js";

/** @typedef {{label: string, value: any, type?: "number" | "text", unit?: string, options?: string[]}} Field what is asked for */

/**
 * Ask, and give what was entered (or true), or null for no. One question at a time, and a yes that comes at once was meant for
 * something else. The answer is the button's own, taken as it is pressed: the dialog's close event comes later, perhaps when
 * the next question is already there.
 * @param {string} title @param {string} text @param {string} yes @param {Field | null} field
 * @returns {Promise<any>}
 */
export function confirmed(title, text, yes, field = null) {
  const dialog = byId("confirm");
  if (dialog.open) {
    if (title !== byId("confirm-title").textContent || text !== byId("confirm-text").textContent) { // else it was a double click, or is asked already
      toast(t("ask.open"), "warn");
      dialog.querySelector("button").focus();
    }
    return Promise.resolve(null);
  }
  const form = dialog.querySelector("form");
  const input = dialog.querySelector("input");
  byId("confirm-title").textContent = title;
  byId("confirm-text").textContent = text;
  byId("confirm-yes").textContent = yes;
  const label = byId("confirm-field");
  label.hidden = !field;
  input.disabled = !field;
  if (field) {
    label.querySelector("span").textContent = field.label;
    label.querySelector("i").textContent = field.type === "text" ? "" : field.unit || "m";
    byId("modes").replaceChildren(...(field.options || []).map((each) => Object.assign(make("option"), { value: each })));
    input.type = field.type || "number";
    input.min = field.type === "text" ? "" : "0.1";
    input.max = field.type === "text" ? "" : "10000";
    input.required = true;
    input.value = field.value;
  }
  const appeared = performance.now();
  byId("confirm-yes").onclick = (/** @type {MouseEvent} */ event) => {
    if (!meant(event, appeared)) event.preventDefault();
  };
  byId("confirm-yes").onkeydown = (/** @type {KeyboardEvent} */ event) => {
    if (event.repeat) event.preventDefault(); // a key that is held is one press, which may have come too early
  };
  dialog.show(); // in a corner, and not modal: a hold waits for no answer
  return new Promise((resolve) => {
    form.onsubmit = (/** @type {SubmitEvent} */ event) => {
      const button = /** @type {HTMLButtonElement | null} */ (event.submitter);
      const agreed = button !== null && button.value === "yes";
      const entered = field && (field.type === "text" ? input.value.trim() : Number(input.value));
      resolve(agreed ? (field ? entered : true) : null);
    };
    input.onkeydown = (/** @type {KeyboardEvent} */ event) => {
      if (event.key !== "Enter") return;
      event.preventDefault(); // the form's own Enter is its first button, which is no
      if (event.repeat || !meant(event, appeared)) return;
      form.requestSubmit(byId("confirm-yes"));
    };
    dialog.oncancel = () => resolve(null);
    dialog.onkeydown = (/** @type {KeyboardEvent} */ event) => {
      if (event.key !== "Escape") return;
      dialog.close();
      resolve(null);
    };
  });
}
