"use strict";
// Pictures of the ground below everything else, out of the file that the gateway was started with.

/** @param {FleetMap} view */
async function showGround(view) {
  const [kind, closest] = /** @type {HTMLMetaElement} */ (document.querySelector("meta[name=zmav-tiles]")).content.split(" ");
  if (!kind) return;
  view.map.createPane("ground").style.zIndex = "155";
  const how = { pane: "ground", maxZoom: CLOSEST };
  try {
    if (kind === "mbtiles") {
      L.tileLayer(address("tiles/{z}/{x}/{y}"), { ...how, maxNativeZoom: Number(closest) }).addTo(view.map);
      return;
    }
    const archive = new pmtiles.PMTiles(address("tiles"));
    const header = await archive.getHeader();
    if (header.tileType === pmtiles.TileType.Mvt) return toast("The tiles are vectors, which are not drawn here: pictures (PNG, JPEG, WebP) are", "warn", 15000);
    pmtiles.leafletRasterLayer(archive, { ...how, minZoom: 1, minNativeZoom: header.minZoom, maxNativeZoom: header.maxZoom }).addTo(view.map);
  } catch (error) {
    toast(`No pictures of the ground: ${error.message}`, "bad", 15000);
  }
}
