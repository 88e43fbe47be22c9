// A mapping survey of an area that was drawn: camera, overlaps and height, as planners of single flights ask for them.

import { keep, kept, make, makeButton, toast } from "./dom.js";
import { planFirst } from "./planner.js";
import { obstacleOf } from "./shapes.js";
import { t } from "./words.js";

/** @typedef {{camera: string, pixels: string, height: string, front: string, side: string, heading: string, trigger: boolean}} Entered as it was typed */
/** @typedef {Exclude<keyof Entered, "trigger">} Typed */

/** @type {Entered} */
const USUAL = { camera: "13.2x8.8/8.8", pixels: "5472", height: "60", front: "75", side: "65", heading: "", trigger: false };

/** m of ground in a picture from 1 m above, across and along the way; null: not understood. @param {string} text @returns {[number, number] | null} */
export function cameraOf(text) {
  const found = text.replace(/\s/g, "").match(/^(\d+(?:\.\d+)?)x(\d+(?:\.\d+)?)(?:\/(\d+(?:\.\d+)?)|(deg|°))$/);
  if (!found) return null;
  const [wide, high] = [Number(found[1]), Number(found[2])];
  const ratio = (/** @type {number} */ each) => (found[3] ? each / Number(found[3]) : each < 180 ? 2 * Math.tan((each * Math.PI) / 360) : NaN);
  const [a, b] = [ratio(wide), ratio(high)];
  return Number.isFinite(a) && Number.isFinite(b) && a > 0 && b > 0 ? [Math.max(a, b), Math.min(a, b)] : null;
}

/** @param {Entered} entered @returns {any} the goal's fields, or in "wrong" the text's key of what is wrong */
export function surveyOf(entered) {
  const camera = cameraOf(entered.camera);
  const [height, front, side, pixels, heading] = [entered.height, entered.front, entered.side, entered.pixels || "0", entered.heading || "0"].map(Number);
  if (!camera) return { wrong: "survey.camera.wrong" };
  if (!(height > 0)) return { wrong: "survey.height.wrong" };
  if (![front, side].every((share) => share >= 0 && share <= 90)) return { wrong: "survey.overlap.wrong" };
  if (!Number.isInteger(pixels) || pixels < 0 || !Number.isFinite(heading)) return { wrong: "survey.number.wrong" };
  return { camera, height, front: front / 100, overlap: side / 100, pixels, trigger: entered.trigger, angle: entered.heading === "" ? null : (heading * Math.PI) / 180 };
}

/** The form below an area. @param {import("./drawing.js").Drawing} drawing @param {import("./shapes.js").Shape} shape */
export function surveyForm(drawing, shape) {
  /** @type {Entered} */
  const entered = { ...USUAL, ...kept("survey", {}) };
  const field = (/** @type {import("./words.js").TextKey} */ key, /** @type {Typed} */ name) => {
    const input = make("input", "survey-field");
    input.value = entered[name];
    input.name = name;
    input.addEventListener("change", () => {
      entered[name] = input.value.trim();
      keep("survey", entered);
    });
    return make("label", "", "", `${t(key)} `, input);
  };
  const trigger = make("input");
  trigger.type = "checkbox";
  trigger.name = "trigger";
  trigger.checked = entered.trigger;
  trigger.addEventListener("change", () => {
    entered.trigger = trigger.checked;
    keep("survey", entered);
  });
  const fly = async () => {
    const origin = drawing.origin;
    if (!origin) return;
    const vehicles = drawing.store.chosen.map((vehicle) => vehicle.name);
    if (!vehicles.length) return void toast(t("draw.who"), "bad");
    const { wrong, ...fields } = surveyOf(entered);
    if (wrong) return void toast(t(wrong), "bad");
    await planFirst({ kind: "survey", vehicles, polygon: obstacleOf(shape, origin).what.polygon, ...fields }, drawing.plans);
  };
  const fields = make("div", "shape-numbers", "", field("survey.camera", "camera"), field("survey.pixels", "pixels"), field("survey.height", "height"), field("survey.front", "front"), field("survey.side", "side"), field("survey.heading", "heading"), make("label", "", "", trigger, ` ${t("survey.trigger")}`));
  return make("details", "survey", "", make("summary", "", t("survey")), fields, makeButton(t("survey.fly"), "small safe", fly, t("draw.fly.title")));
}
