// Areas that a person draws: what they are, each change undone, and the files and lines that the command line takes.

import { keep, kept } from "./dom.js";
import { toNed } from "./geo.js";
import { t } from "./words.js";

/**
 * @typedef {import("./types.js").Place} Place
 * @typedef {"no_fly" | "geofence" | "search" | "obstacle"} ShapeKind
 * @typedef {{id: number, name: string, kind: ShapeKind, points: Place[], radius: number, floor: number, ceiling: number}} Shape
 * points: corners; of an obstacle its centre alone. floor, ceiling: m above the fleet's origin; of a search area ceiling is
 * the height that it is flown at
 */

/** @type {Record<ShapeKind, string>} */
export const KIND_WORD = { no_fly: t("draw.no-fly"), geofence: t("draw.fence"), search: t("draw.search"), obstacle: t("draw.obstacle") };

export class Shapes {
  constructor() {
    /** @type {Shape[]} */
    this.all = kept("shapes", []);
    /** @type {string[]} what was, as JSON, the newest last */
    this.past = [];
  }

  /** Change something so that it can be undone. @param {() => void} how */
  change(how) {
    this.past.push(JSON.stringify(this.all));
    if (this.past.length > 100) this.past.shift();
    how();
    keep("shapes", this.all);
  }

  undo() {
    const before = this.past.pop();
    if (before === undefined) return;
    this.all = JSON.parse(before);
    keep("shapes", this.all);
  }

  /** @param {ShapeKind} kind @param {Place[]} points @returns {Shape} */
  add(kind, points) {
    const number = 1 + Math.max(0, ...this.all.map((each) => each.id));
    const name = `${{ no_fly: "nofly", geofence: "fence", search: "search", obstacle: "obstacle" }[kind]}${number}`;
    const shape = { id: number, name, kind, points, radius: 5, floor: kind === "geofence" ? -5 : -100, ceiling: kind === "search" ? 20 : kind === "geofence" ? 120 : 200 };
    this.change(() => this.all.push(shape));
    return shape;
  }

  /** @param {Shape} shape */
  remove(shape) {
    this.change(() => (this.all = this.all.filter((each) => each.id !== shape.id)));
  }
}

/**
 * As the planner takes it: see zmav/wire/swarm.py.
 * @param {Shape} shape @param {Place} origin @returns {import("./types.js").Obstacle}
 */
export function obstacleOf(shape, origin) {
  const corners = shape.points.map((point) => /** @type {[number, number]} */ (toNed(origin, point).map((m) => Number(m.toFixed(2)))));
  const heights = { floor: shape.floor, ceiling: shape.ceiling };
  const what = shape.kind === "obstacle" ? { shape: "cylinder", center: corners[0], radius: shape.radius, ...heights } : { shape: shape.kind, polygon: corners, ...heights };
  return { name: shape.name, t: Date.now() / 1000, what };
}

/** The line that does the same. @param {Shape} shape @param {Place} origin @param {string[]} names */
export function commandOf(shape, origin, names) {
  const corners = shape.points.map((point) => toNed(origin, point).map((m) => m.toFixed(1)).join(","));
  const heights = `--floor ${shape.floor} --ceiling ${shape.ceiling}`;
  if (shape.kind === "search") return `zmav swarm search ${names.length ? names.join(" ") : "'*'"} --polygon '${corners.join(" ")}' --alt ${shape.ceiling}`;
  if (shape.kind === "obstacle") return `zmav swarm obstacle add ${shape.name} --cylinder=${corners[0]} --radius ${shape.radius} ${heights}`;
  return `zmav swarm obstacle add ${shape.name} --${shape.kind === "no_fly" ? "no-fly" : "geofence"}='${corners.join(" ")}' ${heights}`;
}

/** A .plan for 'zmav mission upload': fences to stay in, no-fly areas and obstacles to stay out of. @param {Shape[]} shapes */
export function planFileOf(shapes) {
  const at = (/** @type {Place} */ point) => [Number(point.lat.toFixed(7)), Number(point.lon.toFixed(7))];
  const polygons = shapes.filter((each) => each.kind === "no_fly" || each.kind === "geofence").map((each) => ({ version: 1, inclusion: each.kind === "geofence", polygon: each.points.map(at) }));
  const circles = shapes.filter((each) => each.kind === "obstacle").map((each) => ({ version: 1, inclusion: false, circle: { center: at(each.points[0]), radius: each.radius } }));
  return {
    fileType: "Plan",
    version: 1,
    groundStation: "zmav",
    geoFence: { version: 2, polygons, circles },
    mission: { version: 2, items: [], firmwareType: 3, vehicleType: 2, cruiseSpeed: 10, hoverSpeed: 5, plannedHomePosition: [0, 0, 0] },
    rallyPoints: { version: 2, points: [] },
  };
}

/** The [geofence] table of a fleet file. @param {Shape} shape */
export function fenceTableOf(shape) {
  const corners = shape.points.map((point) => `  [${point.lat.toFixed(7)}, ${point.lon.toFixed(7)}],`);
  return `[geofence]\npolygon = [\n${corners.join("\n")}\n]\nfloor = ${shape.floor.toFixed(1)}\nceiling = ${shape.ceiling.toFixed(1)}\n`;
}
