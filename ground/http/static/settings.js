// What the gateway says of itself in the document's head, and its addresses with the token where this page has one.

/** @param {string} name */
const told = (name) => /** @type {HTMLMetaElement | null} */ (document.querySelector(`meta[name=zmav-${name}]`))?.content ?? "";

export const READ_ONLY = told("read-only") === "yes";
export const FLEET = told("fleet");
/** Kind of the file of tiles, and how close it goes. */
export const TILES = told("tiles");
/** A recording is played. */
export const REPLAY = told("replay") === "yes";
/** Corners of the picture laid over the map: south, west, north, east. */
export const PICTURE = told("picture").split(" ").filter(Boolean).map(Number);
const TOKEN = new URLSearchParams(location.search).get("token");

/** An address of the gateway. @param {string} path */
export function address(path) {
  return TOKEN ? `${path}${path.includes("?") ? "&" : "?"}token=${encodeURIComponent(TOKEN)}` : path;
}
