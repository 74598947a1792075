// The connection, over sockets of the test's own: the token, the hello, sequence numbers, and what happens when the
// server is lost or refuses.

import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";
import { page } from "./page.js";

const { Connection, take_token } = await page("connection");

let sockets;
/** The clock and the one wait that runs. */
let [now, waiting] = [0, null];

/** Lets so many ms pass. */
function pass(ms) {
  now += ms;
  if (waiting !== null && waiting.at <= now) {
    const { call } = waiting;
    waiting = null;
    call();
  }
}

class FakeSocket {
  static OPEN = 1;

  constructor(address) {
    Object.assign(this, { address: String(address), listeners: {}, sent: [], readyState: 0, bufferedAmount: 0 });
    sockets.push(this);
  }

  addEventListener(name, call) {
    this.listeners[name] = call;
  }

  send(text) {
    this.sent.push(JSON.parse(text));
  }

  opens() {
    this.readyState = 1;
    this.listeners.open();
  }

  closes(code = 1006) {
    this.readyState = 3;
    this.listeners.close({ code });
  }
}

beforeEach(() => {
  sockets = [];
  waiting = null;
  globalThis.clearTimeout = () => { waiting = null; };
  globalThis.setTimeout = (call, ms) => {
    assert.equal(waiting, null, "at most one wait runs");
    waiting = { call, at: now + ms };
    return 1;
  };
  const kept = new Map();
  globalThis.WebSocket = FakeSocket;
  globalThis.sessionStorage = { getItem: (key) => kept.get(key) ?? null, setItem: (key, text) => kept.set(key, text) };
  globalThis.location = { hash: "#token=abc&view=1", pathname: "/deep/", protocol: "https:",
    get href() { return `https://host/deep/${this.hash}`; } };
  globalThis.history = { replaceState: (state, title, address) => { location.hash = address.replace(/^[^#]*/, ""); } };
});

/** A connection, and what it told. */
function connected() {
  const told = { states: [], messages: [], frames: [] };
  const connection = new Connection({ state: (name) => told.states.push(name), size: () => [4, 3],
    message: (message) => told.messages.push(message), frame: (buffer) => told.frames.push(buffer),
    frame_shown: () => null });
  connection.open();
  sockets[0].opens();
  return { connection, told };
}

test("the token leaves the address, and nothing else does", () => {
  assert.equal(take_token(), "abc");
  assert.equal(location.hash, "#view=1");
  assert.equal(take_token(), "abc", "an earlier load kept it");
});

test("the socket is beside the page, and says hello with the token", () => {
  connected();
  assert.equal(sockets[0].address, "wss://host/deep/socket");
  assert.deepEqual(sockets[0].sent, [{ type: "hello", token: "abc", size: [4, 3] }]);
});

test("messages are objects with a type; all else is dropped", () => {
  const { told } = connected();
  const bytes = new ArrayBuffer(3);
  for (const data of ["{\"type\":\"stats\",\"fps\":2}", "null", "3", "[]", "{}", "{\"type\":3}", "no", "", bytes]) {
    sockets[0].listeners.message({ data });
  }
  assert.deepEqual(told.messages, [{ type: "stats", fps: 2 }]);
  assert.deepEqual(told.frames, [bytes]);
});

test("events have rising numbers, also while nothing can be sent", () => {
  const { connection } = connected();
  assert.equal(connection.send_event({ type: "camera" }), 1);
  sockets[0].closes();
  assert.equal(connection.send({ type: "rest" }), false);
  assert.equal(connection.send_event({ type: "camera" }), 2);
  pass(250);
  sockets[1].opens();
  assert.equal(connection.send_event({ type: "size" }), 3);
  assert.deepEqual(sockets[1].sent.slice(1), [{ type: "size", seq: 3 }]);
});

test("a server that is lost is tried again, less and less often", () => {
  const { told } = connected();
  for (const wait of [250, 500, 1000, 2000, 4000, 4000]) {
    const before = sockets.length;
    sockets.at(-1).closes();
    pass(wait - 1);
    assert.equal(sockets.length, before, `before ${wait} ms`);
    pass(1);
    assert.equal(sockets.length, before + 1, `after ${wait} ms`);
  }
  assert.deepEqual(told.states.slice(0, 3), ["connecting", "lost", "reconnecting"]);
  // Once it answers, the waits are short again.
  sockets.at(-1).opens();
  sockets.at(-1).listeners.message({ data: "{\"type\":\"welcome\"}" });
  sockets.at(-1).closes();
  const before = sockets.length;
  pass(250);
  assert.equal(sockets.length, before + 1);
});

test("what an old socket says is not heard", () => {
  const { told } = connected();
  sockets[0].closes();
  pass(250);
  sockets[0].listeners.message({ data: "{\"type\":\"stats\"}" });
  sockets[0].closes();
  assert.deepEqual(told.messages, []);
  assert.deepEqual(told.states, ["connecting", "lost", "reconnecting"]);
});

test("a refused token is not tried again", () => {
  const { told } = connected();
  sockets[0].closes(4401);
  pass(100_000);
  assert.equal(sockets.length, 1);
  assert.equal(told.states.at(-1), "refused");
});

/** Who pasted the right address over a refused one saw no change: a new fragment alone loads no page. */
test("a new token in the address is tried at once where the old one was refused", () => {
  const { connection, told } = connected();
  sockets[0].closes(4401);
  connection.renew();
  assert.equal(sockets.length, 1, "the same token is as wrong as before");
  location.hash = "#token=new";
  connection.renew();
  sockets[1].opens();
  assert.equal(sockets[1].sent[0].token, "new");
  assert.equal(told.states.at(-1), "connecting");
  // One that is there while the connection stands is kept for the next time, and changes nothing else.
  location.hash = "#token=newer";
  connection.renew();
  assert.equal(sockets.length, 2);
  sockets[1].closes();
  pass(250);
  sockets[2].opens();
  assert.equal(sockets[2].sent[0].token, "newer");
});
