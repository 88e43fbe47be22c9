// Orders: what makes a vehicle safe is two presses away, what moves it is behind a question.

import { confirmed } from "./ask.js";
import { meant, toast } from "./dom.js";
import { address } from "./settings.js";
import { few, t, wordsOf } from "./words.js";

const ASK_AGAIN_MS = 500; // between requests: a browser has six at once, and a hold must not wait for one of them
const UNDER_WAY = ["running", "returning"]; // how it stands with a vehicle whose order has not ended

/**
 * What the gateway says of an order.
 * @typedef {{fleet: string, vehicle: string, status: string, text: string}} Outcome of one vehicle
 * @typedef {{status: string, notes: string[], vehicles: Outcome[]}} Ordered
 */

/** @param {string} path @param {any} args */
export const post = (path, args) => postText(path, JSON.stringify(args));

/** The gateway's answer; throws its words where it refuses. @param {string} path @param {string} text @returns {Promise<any>} */
export async function postText(path, text) {
  const answer = await fetch(address(path), { method: "POST", body: text });
  const body = await answer.json();
  if (!answer.ok) throw new Error(body.error.text);
  return body;
}

/**
 * Give vehicles ("demo/quad1", patterns) an order, and say of each how it ended and not before. What is asked of whom, and
 * when it is done, the gateway knows; the vehicles see it through by themselves, whatever becomes of this page.
 * @param {string[]} vehicles @param {string} verb @param {any} args
 */
export async function order(vehicles, verb, args = {}) {
  const whom = few(vehicles.map((each) => each.split("/").pop() || "")).replace(/^\*$/, t("all"));
  const box = toast(t("order.waits", { who: whom, verb }), "", 0);
  const id = `${Date.now()}-${Math.random()}`;
  /** @type {Set<string>} */
  const said = new Set();
  const once = (/** @type {string} */ key, /** @type {string} */ text, /** @type {string} */ kind) => {
    if (said.has(key)) return;
    said.add(key);
    toast(text, kind, kind === "good" ? 5000 : 15000);
  };
  try {
    for (;;) {
      /** @type {Ordered} */
      const body = await post(`fleet/${verb}`, { ...args, vehicles, id, wait: 0.3 });
      for (const note of body.notes) once(note, note, "");
      for (const each of body.vehicles) {
        if (UNDER_WAY.includes(each.status)) continue;
        const text = each.status === "failed" ? t("order.failed", { text: each.text }) : each.text;
        once(`${each.fleet}/${each.vehicle}`, `${each.vehicle}: ${verb} ${text}`, { done: "good", failed: "bad" }[each.status] || "");
      }
      if (body.status !== "running") break;
      box.textContent = t("order.waits", { who: body.vehicles.filter((each) => UNDER_WAY.includes(each.status)).map((each) => each.vehicle).join(", "), verb });
      await new Promise((resolve) => setTimeout(resolve, ASK_AGAIN_MS));
    }
  } catch (error) {
    toast(t("order.unknown", { who: whom, verb, text: wordsOf(error) }), "bad", 15000);
  }
  box.remove();
}

/**
 * A button that does nothing until it is pressed a second time within four seconds; a double click is one press.
 * Returns what has it asked from the beginning again.
 * @param {HTMLButtonElement} button @param {() => void} act @returns {() => void}
 */
export function armTwice(button, act) {
  let label = button.textContent;
  /** @type {ReturnType<typeof setTimeout> | undefined} */
  let timer;
  let askedAt = 0;
  const rest = () => {
    clearTimeout(timer);
    timer = undefined;
    button.textContent = label;
    button.classList.remove("asking");
  };
  button.addEventListener("keydown", (event) => {
    if (event.repeat) event.preventDefault(); // a key that is held is one press
  });
  button.addEventListener("click", (event) => {
    if (timer) {
      if (!meant(event, askedAt)) return;
      rest();
      act();
    } else {
      label = button.textContent;
      button.textContent = t("order.sure", { label: label || "" });
      button.classList.add("asking");
      askedAt = performance.now();
      timer = setTimeout(rest, 4000);
    }
  });
  return () => {
    if (timer) rest();
  };
}

/** @param {string[]} ids @param {string[]} names @param {boolean} armed */
export async function askArm(ids, names, armed) {
  const [title, text, yes] = armed ? [t("disarm.title", { who: few(names, 8) }), t("disarm.text"), t("disarm")] : [t("arm.title", { who: few(names, 8) }), t("arm.text"), t("arm")];
  if (await confirmed(title, text, yes)) await order(ids, armed ? "disarm" : "arm");
}

/** The height to take off to, or null. @param {string[]} names @param {string} how */
export async function askHeight(names, how) {
  const field = { label: t("height.field"), value: 10 };
  const height = await confirmed(t("takeoff.title", { who: few(names, 8) }), t("takeoff.text", { how }), t("takeoff"), field);
  return height > 0 ? Number(height) : null;
}

/** No order can be given while the gateway is lost. @param {boolean} live */
export function allowOrders(live) {
  const buttons = document.querySelectorAll(".card .orders button, #bar button[data-verb], #goals .orders button");
  for (const button of buttons) /** @type {HTMLButtonElement} */ (button).disabled = !live;
}
