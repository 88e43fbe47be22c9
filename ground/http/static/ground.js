// Pictures of the ground below everything else, out of the file that the gateway was started with.

import { toast } from "./dom.js";
import { CLOSEST } from "./map.js";
import { address, PICTURE, TILES } from "./settings.js";
import { L, pmtiles } from "./vendor.js";
import { t, wordsOf } from "./words.js";

/** @param {import("./map.js").FleetMap} view */
export async function showGround(view) {
  const [kind, closest] = TILES.split(" ");
  view.map.createPane("ground").style.zIndex = "155";
  if (PICTURE.length) {
    const [south, west, north, east] = PICTURE;
    view.map.createPane("picture").style.zIndex = "156";
    L.imageOverlay(address("picture"), [[south, west], [north, east]], { pane: "picture", alt: "" }).addTo(view.map);
  }
  if (!kind) return;
  const how = { pane: "ground", maxZoom: CLOSEST };
  try {
    if (kind === "mbtiles") {
      L.tileLayer(address("tiles/{z}/{x}/{y}"), { ...how, maxNativeZoom: Number(closest) }).addTo(view.map);
      return;
    }
    const archive = new pmtiles.PMTiles(address("tiles"));
    const header = await archive.getHeader();
    if (header.tileType === pmtiles.TileType.Mvt) return toast(t("ground.vectors"), "warn", 15000);
    pmtiles.leafletRasterLayer(archive, { ...how, minZoom: 1, minNativeZoom: header.minZoom, maxNativeZoom: header.maxZoom }).addTo(view.map);
  } catch (error) {
    toast(t("ground.failed", { text: wordsOf(error) }), "bad", 15000);
  }
}
