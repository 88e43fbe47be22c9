// The libraries in vendor/, which are classic scripts: each puts its name beside the window's own.

const names = /** @type {any} */ (window);
/** https://leafletjs.com/reference.html @type {any} */
export const L = names.L;
/** https://github.com/protomaps/PMTiles @type {any} */
export const pmtiles = names.pmtiles;
