"use strict";
// Orders: what makes a vehicle safe is two presses away, what moves it is behind a question.

const UNDER_WAY = ["running", "returning"];  // how it stands with a vehicle whose order has not ended

/** @param {string} text @param {string} kind @param {number} lasting ms; 0: until it is removed */
function toast(text, kind, lasting = 6000) {
  const box = make("div", `toast ${kind}`, text);
  byId("toasts").append(box);
  if (lasting) setTimeout(() => box.remove(), lasting);
  return box;
}

/** The gateway's answer; raises its words where it refuses. @param {string} path @param {any} args @returns {Promise<any>} */
async function post(path, args) {
  const answer = await fetch(address(path), { method: "POST", body: JSON.stringify(args) });
  const body = await answer.json();
  if (!answer.ok) throw new Error(body.error.text);
  return body;
}

// Give vehicles ("demo/quad1", patterns) an order, and say of each how it ended and not before. What is asked of whom, and
// when it is done, the gateway knows; the vehicles see it through by themselves, whatever becomes of this page.
async function order(vehicles, verb, args = {}) {
  const whom = few(vehicles.map((each) => each.split("/").pop())).replace(/^\*$/, "all");
  const box = toast(`${whom}: ${verb} …`, "", 0);
  const id = `${Date.now()}-${Math.random()}`;
  const said = new Set();
  const once = (key, text, kind) => {
    if (said.has(key)) return;
    said.add(key);
    toast(text, kind, kind === "good" ? 5000 : 15000);
  };
  try {
    for (let running = true; running; ) {
      const body = await post(`fleet/${verb}`, { ...args, vehicles, id, wait: 1 });
      for (const note of body.notes) once(note, note, "");
      for (const each of body.vehicles) {
        if (UNDER_WAY.includes(each.status)) continue;
        const text = each.status === "failed" ? `not done: ${each.text}` : each.text;
        once(`${each.fleet}/${each.vehicle}`, `${each.vehicle}: ${verb} ${text}`, { done: "good", failed: "bad" }[each.status] || "");
      }
      running = body.status === "running";
      if (running) box.textContent = `${body.vehicles.filter((each) => UNDER_WAY.includes(each.status)).map((each) => each.vehicle).join(", ")}: ${verb} …`;
    }
  } catch (error) {
    toast(`${whom}: no word on ${verb}: ${error.message}`, "bad", 15000);
  }
  box.remove();
}

// A button that does nothing until it is pressed a second time within four seconds.
/** Returns what has it asked from the beginning again. @param {any} button @param {() => void} act @returns {() => void} */
function armTwice(button, act) {
  let label = button.textContent;
  let timer = null;
  const rest = () => {
    clearTimeout(timer);
    timer = null;
    button.textContent = label;
    button.classList.remove("asking");
  };
  button.addEventListener("click", () => {
    if (timer) {
      rest();
      act();
    } else {
      label = button.textContent;
      button.textContent = `${label}?`;
      button.classList.add("asking");
      timer = setTimeout(rest, 4000);
    }
  });
  return () => timer && rest();
}

/** @typedef {{label: string, value: any, type?: "number" | "text", unit?: string, options?: string[]}} Field what is asked for */

/**
 * Ask, and give what was entered (or true), or null for no. One question at a time. The answer is the button's own, taken as
 * it is pressed: the dialog's close event comes later, perhaps when the next question is already there.
 * @param {string} title @param {string} text @param {string} yes @param {Field | null} field
 * @param {boolean} aside beside what is shown on the map
 * @returns {Promise<any>}
 */
function confirmed(title, text, yes, field = null, aside = false) {
  const dialog = byId("confirm");
  if (dialog.open) return Promise.resolve(null);
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
  dialog.classList.toggle("aside", aside);
  dialog.showModal();
  return new Promise((resolve) => {
    form.onsubmit = (event) => {
      const agreed = event.submitter !== null && event.submitter.value === "yes";
      const entered = field && (field.type === "text" ? input.value.trim() : Number(input.value));
      resolve(agreed ? (field ? entered : true) : null);
    };
    dialog.oncancel = () => resolve(null);
  });
}

async function askArm(vehicle, name, armed) {
  const verb = armed ? "disarm" : "arm";
  const text = armed ? "Its motors stop. It is refused in the air." : "Its motors start to turn. Is everybody clear of it?";
  if (await confirmed(`${armed ? "Disarm" : "Arm"} ${name}?`, text, armed ? "Disarm" : "Arm")) await order([vehicle], verb);
}

async function askTakeoff(vehicle, name) {
  const field = { label: "Height above home", value: 10 };
  const alt = await confirmed(`Take off with ${name}?`, "It climbs at once. Is the air above it free?", "Take off", field);
  if (alt !== null && alt > 0) await order([vehicle], "takeoff", { alt_rel: alt });
}
