"use strict";
// Positions on a plane, north up, in metres: no tiles, so that it works where there is no network.

const EARTH_M = 6371008.8;
const TRAIL_MS = 120000;
const LEAST_M = 40; // the least that is shown from edge to edge

class FleetMap {
  constructor(canvas, note) {
    this.canvas = canvas;
    this.note = note;
    this.center = null;
    this.span = null;
  }

  draw(cards) {
    const placed = cards.filter((card) => card.placed);
    const ratio = window.devicePixelRatio || 1;
    const width = this.canvas.clientWidth;
    const height = this.canvas.clientHeight;
    if (!width || !height) return;
    this.canvas.width = width * ratio;
    this.canvas.height = height * ratio;
    const ink = this.canvas.getContext("2d");
    ink.scale(ratio, ratio);
    const look = getComputedStyle(document.documentElement);
    const colour = (name) => look.getPropertyValue(name).trim();
    ink.font = "12px system-ui, sans-serif";
    if (!placed.length) {
      ink.fillStyle = colour("--muted");
      ink.textAlign = "center";
      ink.fillText("no position yet", width / 2, height / 2);
      return;
    }
    this.fit(placed, width, height);
    const scale = Math.min(width, height) / this.span;
    const at = (lat, lon) => {
      const [north, east] = this.metres(lat, lon);
      return [width / 2 + (east - this.center.east) * scale, height / 2 - (north - this.center.north) * scale];
    };
    this.grid(ink, colour, width, height, scale);
    for (const card of placed) this.trail(ink, colour, card, at);
    for (const card of placed) this.vehicle(ink, colour, card, at, width);
  }

  // Metres north and east of the first position that was ever drawn.
  metres(lat, lon) {
    if (!this.zero) this.zero = { lat, lon };
    const rad = Math.PI / 180;
    return [(lat - this.zero.lat) * rad * EARTH_M, (lon - this.zero.lon) * rad * EARTH_M * Math.cos(this.zero.lat * rad)];
  }

  // Move the view softly to where everybody is in it.
  fit(placed, width, height) {
    const points = placed.map((card) => this.metres(card.state.position.lat_deg, card.state.position.lon_deg));
    const norths = points.map((p) => p[0]);
    const easts = points.map((p) => p[1]);
    const middle = (values) => (Math.min(...values) + Math.max(...values)) / 2;
    const size = (values) => Math.max(...values) - Math.min(...values);
    const short = Math.min(width, height);
    const need = Math.max(LEAST_M, 1.5 * Math.max((size(easts) * short) / width, (size(norths) * short) / height));
    const aim = { north: middle(norths), east: middle(easts) };
    if (!this.center || Math.abs(Math.log(this.span / need)) > 2) {
      this.center = aim;
      this.span = need;
      return;
    }
    const step = 0.2;
    this.center.north += (aim.north - this.center.north) * step;
    this.center.east += (aim.east - this.center.east) * step;
    this.span *= Math.pow(need / this.span, step);
  }

  grid(ink, colour, width, height, scale) {
    const rough = 70 / scale;
    const tens = Math.pow(10, Math.floor(Math.log10(rough)));
    const cell = [1, 2, 5, 10].map((n) => n * tens).find((n) => n >= rough);
    ink.strokeStyle = colour("--line");
    ink.lineWidth = 1;
    ink.beginPath();
    const west = this.center.east - width / 2 / scale;
    const south = this.center.north - height / 2 / scale;
    for (let e = Math.ceil(west / cell) * cell; (e - west) * scale < width; e += cell) {
      const x = Math.round((e - west) * scale) + 0.5;
      ink.moveTo(x, 0);
      ink.lineTo(x, height);
    }
    for (let n = Math.ceil(south / cell) * cell; (n - south) * scale < height; n += cell) {
      const y = Math.round(height - (n - south) * scale) + 0.5;
      ink.moveTo(0, y);
      ink.lineTo(width, y);
    }
    ink.stroke();
    const text = cell >= 1000 ? `${cell / 1000} km` : `${cell} m`;
    this.note.textContent = `north is up · a square is ${text}`;
    ink.fillStyle = colour("--muted");
    ink.textAlign = "center";
    ink.fillText("N", width - 16, 30);
    ink.beginPath();
    ink.moveTo(width - 16, 6);
    ink.lineTo(width - 11, 17);
    ink.lineTo(width - 21, 17);
    ink.fill();
  }

  trail(ink, colour, card, at) {
    const now = Date.now();
    ink.strokeStyle = colour(card.state.armed ? "--accent" : "--muted");
    ink.lineWidth = 1.5;
    let last = null;
    for (const point of card.trail) {
      const left = 1 - (now - point.at) / TRAIL_MS;
      if (left <= 0) continue;
      const here = at(point.lat, point.lon);
      if (last) {
        ink.globalAlpha = 0.1 + 0.6 * left;
        ink.beginPath();
        ink.moveTo(...last);
        ink.lineTo(...here);
        ink.stroke();
      }
      last = here;
    }
    ink.globalAlpha = 1;
  }

  vehicle(ink, colour, card, at, width) {
    const s = card.state;
    const [x, y] = at(s.position.lat_deg, s.position.lon_deg);
    const paint = colour(card.stale ? "--bad" : s.armed ? "--accent" : "--muted");
    ink.save();
    ink.translate(x, y);
    ink.rotate((s.attitude && Number(s.attitude.yaw)) || 0);
    ink.beginPath();
    ink.moveTo(0, -10);
    ink.lineTo(7, 8);
    ink.lineTo(0, 4);
    ink.lineTo(-7, 8);
    ink.closePath();
    ink.lineWidth = 2;
    ink.strokeStyle = card.stale ? paint : colour("--panel");
    ink.fillStyle = card.stale ? colour("--panel") : paint;
    ink.stroke();
    ink.fill();
    ink.restore();
    const right = x > width - 90;
    ink.textAlign = right ? "right" : "left";
    ink.lineWidth = 3;
    ink.strokeStyle = colour("--panel");
    ink.fillStyle = card.stale ? colour("--bad") : colour("--text");
    const text = `${card.name} ${fixed(s.position.alt_rel, 0)} m`;
    const [side, below] = right ? [-12, 20] : [12, 4]; // beside the next one's, they would cross
    ink.strokeText(text, x + side, y + below);
    ink.fillText(text, x + side, y + below);
  }
}
