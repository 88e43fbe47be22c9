// The fleet from JavaScript, over HTTP and a WebSocket: Node 22, a browser, or 'node --experimental-websocket' of Node 20.
//
//   zmav sim --up                        # in another terminal, and 'zmav http' in a third
//   node ground/examples/fly.mjs         # or with a vehicle and the gateway: quad1 http://127.0.0.1:8088

const [vehicle = "quad1", gateway = "http://127.0.0.1:8088"] = process.argv.slice(2);
const pause = (ms) => new Promise((done) => setTimeout(done, ms));

/** What went wrong on the vehicle: `kind` for programs, the message for people. */
class Refused extends Error {
  constructor({ kind, text }) {
    super(text);
    this.kind = kind;
  }
}

/** An order, asked again with its id until it has ended: an answer may be lost, and nothing is done twice. */
async function order(verb, args = {}) {
  const body = JSON.stringify({ id: crypto.randomUUID(), wait: 1, ...args });
  for (;;) {
    let answer;
    try {
      const headers = { "Content-Type": "application/json" };
      const signal = AbortSignal.timeout(10_000);
      answer = await (await fetch(`${gateway}/do/${vehicle}/${verb}`, { method: "POST", headers, body, signal })).json();
    } catch (error) {
      console.log(`${verb}: no answer (${error.message}), asked again`);
      await pause(1000);
      continue;
    }
    if (answer.error) throw new Refused(answer.error);
    if (answer.status === "done") return answer.result;
    console.log(`${verb}: not done yet`, answer.result);
  }
}

const socket = new WebSocket(`${gateway.replace("http", "ws")}/ws`);
let state;
socket.onopen = () => socket.send(JSON.stringify({ subscribe: "*", hz: 5 }));
socket.onmessage = ({ data }) => {
  const { key, value } = JSON.parse(data);
  if (key?.endsWith(`/${vehicle}/state`)) state = value;
};

console.log("who is there:\n" + (await (await fetch(`${gateway}/vehicles`)).text()));
await order("arm");
await order("takeoff", { alt_rel: 8 });
try {
  await order("goto", { pos: [0, 0, -90000] });
} catch (error) {
  if (!(error instanceof Refused)) throw error;
  console.log(`refused (${error.kind}): ${error.message}: it flies on, nothing has changed`);
}

// The gateway takes the lease for its caller, puts the point five times a second, and gives the lease back.
for (let i = 0; i < 40; i++) {
  const body = JSON.stringify({ pos: [6, 2, -8] });
  const headers = { "Content-Type": "application/json" };
  const reply = await fetch(`${gateway}/setpoint/${vehicle}?as=javascript`, { method: "POST", headers, body });
  if (!reply.ok) throw new Refused((await reply.json()).error);
  await pause(100);
}
console.log("at", state.local, "moved by", state.lease?.holder);
await fetch(`${gateway}/release/${vehicle}?as=javascript`);
await order("land");
console.log("landed");
socket.close();
