// Where things are: WGS84, and metres north and east about the fleet's origin, by the same formulas as zmav/geo.py.

export const RADIAN = Math.PI / 180;

/** @typedef {import("./types.js").Place} Place */

/** Metres a radian of latitude and of longitude, by the radii of curvature. @param {number} latDeg */
export function metresPerRadian(latDeg) {
  const lat = latDeg * RADIAN;
  const w = 1 - 6.69437999014e-3 * Math.sin(lat) ** 2;
  return { north: (6378137 * (1 - 6.69437999014e-3)) / w ** 1.5, east: (6378137 / Math.sqrt(w)) * Math.cos(lat) };
}

/** Metres north and east of a place. @param {Place} origin @param {Place} place @returns {[number, number]} */
export function toNed(origin, place) {
  const m = metresPerRadian(origin.lat);
  const east = ((((place.lon - origin.lon + 180) % 360) + 360) % 360) - 180;
  return [(place.lat - origin.lat) * RADIAN * m.north, east * RADIAN * m.east];
}

/** @param {Place} origin @param {number} north @param {number} east @returns {Place} */
export function toGlobal(origin, north, east) {
  const m = metresPerRadian(origin.lat);
  return { lat: origin.lat + north / m.north / RADIAN, lon: origin.lon + east / m.east / RADIAN };
}

/** Metres, and degrees clockwise from north. @param {Place} a @param {Place} b */
export function wayBetween(a, b) {
  const [north, east] = toNed(a, b);
  return { distance: Math.hypot(north, east), bearing: (Math.atan2(east, north) / RADIAN + 360) % 360 };
}

/**
 * The polygons of a TopoJSON topology as rings of [latitude, longitude].
 * @param {any} topology
 * @returns {[number, number][][][]}
 */
export function polygonsOf(topology) {
  const { scale, translate } = topology.transform;
  const arcs = topology.arcs.map((/** @type {number[][]} */ arc) => {
    let x = 0, y = 0;
    return arc.map(([dx, dy]) => [(y += dy) * scale[1] + translate[1], (x += dx) * scale[0] + translate[0]]);
  });
  // A ring that goes over the antimeridian goes on beyond 180 degrees; one around a pole is closed along it.
  const ring = (/** @type {number[]} */ numbers) => {
    /** @type {[number, number][]} */
    const points = numbers.flatMap((number) => (number < 0 ? [...arcs[~number]].reverse() : arcs[number]));
    let turns = 0;
    const found = points.map(([lat, lon], index) => {
      if (index) turns += Math.round((points[index - 1][1] - lon) / 360);
      return /** @type {[number, number]} */ ([lat, lon + 360 * turns]);
    });
    if (turns) found.push([-85, found[found.length - 1][1]], [-85, found[0][1]]);
    return found;
  };
  /** @type {[number, number][][][]} */
  const polygons = topology.objects.land.geometries.flatMap((/** @type {any} */ each) => (each.type === "Polygon" ? [each.arcs] : each.arcs)).map((/** @type {number[][]} */ rings) => rings.map(ring));
  const beyond = polygons.filter((rings) => rings[0].some((point) => Math.abs(point[1]) > 180.01));
  /** @type {[number, number][][][]} */
  const shifted = beyond.map((rings) => rings.map((points) => points.map(([lat, lon]) => /** @type {[number, number]} */ ([lat, lon - 360 * Math.sign(Math.max(...points.map((p) => p[1])) - 180.005)]))));
  return [...polygons, ...shifted];
}
