// The WebSocket to the gateway: subscribes again when it comes back, and knows when it is dead although it is open.

import { Wholes } from "./changes.js";
import { address } from "./settings.js";

const SILENCE_MS = 5000; // nothing heard, not even an answer to a ping: the connection is dead

/** @typedef {import("./types.js").How} How */

export class Link {
  /**
   * @param {(message: any) => void} onMessage
   * @param {(state: "live" | "lost", heard: number) => void} onState with the time (ms) of the last word
   */
  constructor(onMessage, onState) {
    this.onMessage = onMessage;
    this.onState = onState;
    /** @type {Map<string, How>} */
    this.wanted = new Map();
    this.heard = this.opened = 0;
    /** @type {number | null} ms to the gateway and back */
    this.rtt = null;
    this.delay = 300;
    this.wholes = new Wholes();
    /** @type {WebSocket | null} */
    this.socket = null;
    setInterval(() => this.check(), 1000);
    this.open();
  }

  open() {
    const url = new URL(address("ws"), location.href);
    url.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    const socket = new WebSocket(url);
    this.socket = socket;
    this.opened = Date.now();
    this.wholes.clear();
    socket.onopen = () => {
      this.delay = 300;
      for (const [key, how] of this.wanted) this.send({ subscribe: key, ...how });
      this.ping();
    };
    socket.onmessage = (event) => {
      if (this.socket !== socket) return;
      this.heard = Date.now();
      const message = JSON.parse(event.data);
      if (message.pong !== undefined) this.rtt = Date.now() - message.pong;
      this.onState("live", this.heard);
      const whole = this.wholes.take(message);
      if (whole) this.onMessage(whole);
      else this.send({ whole: message.key });
    };
    socket.onclose = () => this.ended(socket);
  }

  /** @param {WebSocket} socket */
  ended(socket) {
    if (this.socket !== socket) return;
    this.onState("lost", this.heard);
    setTimeout(() => this.open(), this.delay);
    this.delay = Math.min(this.delay * 1.7, 4000);
    this.socket = null;
  }

  /** Once a second: ask for a sign of life, and give a silent connection up. */
  check() {
    const socket = this.socket;
    if (!socket) return;
    if (socket.readyState === WebSocket.OPEN) this.ping();
    if (Date.now() - Math.max(this.heard, this.opened) > SILENCE_MS) {
      this.ended(socket);
      socket.close();
    }
  }

  ping() {
    this.send({ ping: Date.now() });
  }

  /** @param {object} message */
  send(message) {
    if (this.socket && this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  /** @param {string} key @param {How} how */
  subscribe(key, how) {
    this.wanted.set(key, how);
    this.send({ subscribe: key, ...how });
  }

  /** @param {string} key */
  unsubscribe(key) {
    this.wanted.delete(key);
    this.send({ unsubscribe: key });
  }
}
