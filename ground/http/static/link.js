"use strict";
// The WebSocket to the gateway: subscribes again when it comes back, and knows when it is dead although it is open.

const TOKEN = new URLSearchParams(location.search).get("token");
const SILENCE_MS = 5000; // nothing heard, not even an answer to a ping: the connection is dead

// An address of the gateway, with the token where this page has one.
function address(path) {
  return TOKEN ? `${path}${path.includes("?") ? "&" : "?"}token=${encodeURIComponent(TOKEN)}` : path;
}

class Link {
  // onMessage(message), onState(state): "live", or "lost" with the time (ms) of the last word.
  constructor(onMessage, onState) {
    this.onMessage = onMessage;
    this.onState = onState;
    this.wanted = new Map();
    this.heard = 0;
    this.rtt = null;
    this.delay = 300;
    setInterval(() => this.check(), 1000);
    this.open();
  }

  open() {
    const url = new URL(address("ws"), location.href);
    url.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    const socket = new WebSocket(url);
    this.socket = socket;
    this.opened = Date.now();
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
      this.onMessage(message);
    };
    socket.onclose = () => {
      if (this.socket !== socket) return;
      this.onState("lost", this.heard);
      setTimeout(() => this.open(), this.delay);
      this.delay = Math.min(this.delay * 1.7, 4000);
      this.socket = null;
    };
  }

  // Once a second: ask for a sign of life, and give a silent connection up.
  check() {
    if (!this.socket) return;
    if (this.socket.readyState === WebSocket.OPEN) this.ping();
    if (Date.now() - Math.max(this.heard, this.opened) > SILENCE_MS) {
      const dead = this.socket;
      dead.onclose(null);
      dead.close();
    }
  }

  ping() {
    this.send({ ping: Date.now() });
  }

  send(message) {
    if (this.socket && this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  // how: {hz} a second at most, {history} past events first.
  subscribe(key, how) {
    this.wanted.set(key, how);
    this.send({ subscribe: key, ...how });
  }

  unsubscribe(key) {
    this.wanted.delete(key);
    this.send({ unsubscribe: key });
  }
}
