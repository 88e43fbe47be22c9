// Where everybody would be at a time of what is planned: of a preview if one is shown, else of what is flown.

/**
 * @typedef {import("./types.js").TrackPoint} TrackPoint
 * @typedef {{begin: number, makespan: number, tracks: import("./types.js").Tracks}} Part begin: s after the timeline's
 */

/** Where a track is, by a straight line between its points; before and after it: its ends. @param {TrackPoint[]} track @param {number} t @returns {TrackPoint | null} */
export function pointAt(track, t) {
  if (!track.length) return null;
  const after = track.findIndex((point) => point[0] >= t);
  if (after <= 0) return after === 0 ? track[0] : track[track.length - 1];
  const [a, b] = [track[after - 1], track[after]];
  const part = (t - a[0]) / (b[0] - a[0] || 1);
  return a.map((value, index) => value + part * (b[index] - value));
}

/** The parts one after another. @param {import("./types.js").Step[]} steps @returns {Part[]} */
export function ofPreview(steps) {
  let begin = 0;
  return steps.map(({ tracks = {}, makespan }) => {
    begin += makespan;
    return { begin: begin - makespan, makespan, tracks };
  });
}

/** Side by side, from the first one's start. @param {import("./types.js").Plan[]} plans @returns {{start: number, parts: Part[]}} */
export function ofPlans(plans) {
  const start = Math.min(...plans.map((plan) => plan.start));
  return { start, parts: plans.map((plan) => ({ begin: plan.start - start, makespan: plan.makespan, tracks: plan.tracks })) };
}

/** @param {Part[]} parts */
export const lengthOf = (parts) => Math.max(0, ...parts.map((part) => part.begin + part.makespan));

/** Of each vehicle the point of the last part that has begun, or the first one's. @param {Part[]} parts @param {number} t @returns {Map<string, TrackPoint>} */
export function placesAt(parts, t) {
  const found = new Map();
  for (const part of parts)
    for (const [name, track] of Object.entries(part.tracks)) {
      const point = pointAt(track, t - part.begin);
      if (point && (part.begin <= t || !found.has(name))) found.set(name, point);
    }
  return found;
}
