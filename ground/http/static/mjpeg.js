// Pictures out of a multipart stream, as ground/http/cameras.py sends them.

import { address } from "./settings.js";
import { t } from "./words.js";

/** @typedef {{jpeg: Blob, t: number, seq: number}} Picture t: UTC s of the exposure by the camera's clock */

const HEAD_END = [13, 10, 13, 10];
const LONGEST_HEAD = 1000;
const text = new TextDecoder("latin1");

/**
 * Read pictures until the stream ends; throws where it breaks off, and the gateway's words where it refuses.
 * @param {string} path @param {AbortSignal} signal @param {(picture: Picture) => void} take
 */
export async function readPictures(path, signal, take) {
  const answer = await fetch(address(path), { signal });
  if (!answer.ok || !answer.body) throw new Error((await answer.json()).error.text);
  const reader = answer.body.getReader();
  let held = new Uint8Array(0);
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return;
    held = joined(held, value);
    for (let found = firstOf(held); found; found = firstOf(held)) {
      take(found.picture);
      held = held.subarray(found.end);
    }
  }
}

/** @param {Uint8Array} a @param {Uint8Array} b */
function joined(a, b) {
  const both = new Uint8Array(a.length + b.length);
  both.set(a);
  both.set(b, a.length);
  return both;
}

/** The first picture and where it ends; null: it is not whole yet. @param {Uint8Array} bytes @returns {{picture: Picture, end: number} | null} */
function firstOf(bytes) {
  const body = bodyOf(bytes);
  if (!body) return null;
  const head = text.decode(bytes.subarray(0, body));
  const number = (/** @type {string} */ name) => Number(new RegExp(`^${name}: ([\\d.]+)`, "im").exec(head)?.[1] ?? NaN);
  const length = number("content-length");
  if (!(length > 0)) throw new Error(t("camera.garbled"));
  const end = body + length;
  if (bytes.length < end) return null;
  return { picture: { jpeg: new Blob([bytes.slice(body, end)], { type: "image/jpeg" }), t: number("x-timestamp"), seq: number("x-sequence") }, end };
}

/** Where what is behind the headers begins; 0: they are not whole yet. @param {Uint8Array} bytes */
function bodyOf(bytes) {
  const most = Math.min(bytes.length, LONGEST_HEAD) - HEAD_END.length;
  for (let at = 0; at <= most; at++) if (HEAD_END.every((each, i) => bytes[at + i] === each)) return at + HEAD_END.length;
  if (bytes.length >= LONGEST_HEAD) throw new Error(t("camera.garbled"));
  return 0;
}
