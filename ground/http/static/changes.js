// Whole messages out of those that say only what changed: see ground/http/changes.py.

/** @typedef {import("./types.js").Message} Message */

/** What changed is put into a copy: a view may hold the one before. @param {any} before @param {any} changes @returns {any} */
function merged(before, changes) {
  const object = (/** @type {any} */ value) => value !== null && typeof value === "object" && !Array.isArray(value);
  if (!object(before) || !object(changes)) return changes;
  const after = { ...before };
  for (const [name, value] of Object.entries(changes)) after[name] = merged(before[name], value);
  return after;
}

export class Wholes {
  constructor() {
    /** @type {Map<string, {n: number, message: Message}>} the last of each key */
    this.last = new Map();
  }

  /** After a new connection nothing is known any more. */
  clear() {
    this.last.clear();
  }

  /** The whole message; null where one before it is missing. @param {any} message @returns {Message | null} */
  take(message) {
    if (message.n === undefined) return message;
    const last = this.last.get(message.key);
    let whole = message;
    if (message.changes) {
      if (!last || message.n !== last.n + 1) {
        this.last.delete(message.key);
        return null;
      }
      whole = { ...merged(last.message, message.changes), t: message.t };
    }
    this.last.set(message.key, { n: message.n, message: whole });
    return whole;
  }
}
