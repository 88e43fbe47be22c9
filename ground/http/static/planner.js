// What the planner in charge is asked, and the ways that it would fly shown before a person agrees.

import { confirmed } from "./ask.js";
import { byId, toast } from "./dom.js";
import { post } from "./orders.js";
import { few, fixed, metres, span, t, wordsOf } from "./words.js";

/** @typedef {import("./types.js").Goal} Goal */

/** Ask the planner in charge, and say what came of it. @param {string} verb @param {any} args @returns {Promise<any>} */
export async function askPlanner(verb, args) {
  try {
    const { result } = await post(`swarm/${verb}`, args);
    const goals = result.goals ? result.goals.join(", ") || t("planner.nothing") : result.goal || "";
    toast(t("planner.done", { verb, goals }), "good", 5000);
    return result;
  } catch (error) {
    toast(t("planner.failed", { verb, text: wordsOf(error) }), "bad", 15000);
    return null;
  }
}

/** Of a search or a survey: what comes of it, and what each needs for its part. @param {import("./types.js").Step[]} steps @returns {string[]} */
function figuresOf(steps) {
  return steps.flatMap((step) => {
    if (!step.figures) return [];
    const rows = Object.entries(step.figures).map(([name, each]) => {
      const left = each.battery_left === null ? "" : t("preview.left", { percent: fixed(100 * each.battery_left, 0) });
      const pictures = each.pictures === undefined ? "" : t("preview.pictures", { count: each.pictures });
      return t("preview.part", { name, span: span(each.seconds), metres: metres(each.metres), percent: fixed(100 * each.battery, 0), left, pictures });
    });
    return [step.text || "", ...rows];
  });
}

/**
 * Show what would be flown, and have it flown if a person agrees.
 * @param {Goal} goal @param {import("./planlayer.js").PlanLayer} plans
 */
export async function planFirst(goal, plans) {
  const names = few(goal.vehicles, 8);
  const box = toast(t("preview.waits", { who: names }), "", 0);
  let preview;
  try {
    preview = (await post("swarm/preview", { goal })).result;
  } catch (error) {
    toast(t("preview.failed", { who: names, text: wordsOf(error) }), "bad", 15000);
    return;
  } finally {
    box.remove();
  }
  for (const step of preview.steps) step.makespan = step.makespan || 0; // what has no end yet: follow
  const busy = byId("confirm").open; // another question, whose ways stay on the map
  if (!busy) plans.preview(preview.steps);
  plans.draw();
  const clear = preview.clearance === null ? "" : t("preview.clear", { metres: metres(preview.clearance) });
  const takes = span(preview.seconds ?? preview.makespan); // the plan's own time is only part of it; an older planner says no more
  const lines = [t("preview.text", { span: takes, clear }), ...(preview.refused ? [preview.refused] : []), ...figuresOf(preview.steps)];
  const yes = await confirmed(t("preview.title", { goal: goal.kind, who: names }), lines.join("\n"), t("preview.yes"));
  if (!busy) plans.preview([]);
  if (yes) await askPlanner("submit", { goal });
}
