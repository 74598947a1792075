// The socket to the server: opens it, says hello, hands on what comes, opens it again when it is lost.
//
// Invariants: 1. the token is in sessionStorage and in the hello, never in the visible address; 2. `seq` rises with
// each event of this page; 3. at most one wait to reconnect runs; 4. a server that refuses the token is asked no more.

import { CLOSE_BAD_TOKEN } from "./wire.js";

/** Waits before a new try, ms: at once, then longer and longer. */
const BACK_OFF_MS = [250, 500, 1000, 2000, 4000];
const TOKEN_KEY = "trex-token";
/** Most of what may wait in the socket before further cameras are held back, bytes. */
const BACKLOG_MAX_BYTES = 64 * 1024;

/** The parameters of the address's fragment. */
export function fragment() {
  return new URLSearchParams(location.hash.slice(1));
}

/** Writes `parameters` into the address without a new entry in the history. */
export function replace_fragment(parameters) {
  const text = parameters.toString().replaceAll("%2C", ",");
  history.replaceState(null, "", location.pathname + (text === "" ? "" : `#${text}`));
}

/** Takes the token out of the address, or what an earlier load of the page kept. */
export function take_token() {
  const parameters = fragment();
  const given = parameters.get("token");
  if (given !== null) {
    sessionStorage.setItem(TOKEN_KEY, given);
    parameters.delete("token");
    replace_fragment(parameters);
  }
  return sessionStorage.getItem(TOKEN_KEY) ?? "";
}

export class Connection {
  /**
   * `handlers`: state(name), message(object), frame(ArrayBuffer), size() -> [w, h], frame_shown() -> number | null.
   */
  constructor(handlers) {
    this.handlers = handlers;
    this.token = take_token();
    this.seq = 0;
    this.tries = 0;
    this.socket = null;
    this.timer = null;
    this.counts = { received_bytes: 0, sent_messages: 0, connections: 0 };
  }

  open() {
    clearTimeout(this.timer);
    this.timer = null;
    this.handlers.state(this.tries === 0 ? "connecting" : "reconnecting");
    // Beside the page, which may stand below the path of a proxy.
    const address = new URL("socket", location.href);
    address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    address.hash = "";
    const socket = new WebSocket(address);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    socket.addEventListener("open", () => this.hello(socket));
    socket.addEventListener("message", (event) => this.received(socket, event.data));
    socket.addEventListener("close", (event) => this.closed(socket, event));
  }

  hello(socket) {
    this.counts.connections += 1;
    const frame = this.handlers.frame_shown();
    const message = { type: "hello", token: this.token, size: this.handlers.size() };
    socket.send(JSON.stringify(frame === null ? message : { ...message, frame }));
  }

  received(socket, data) {
    if (socket !== this.socket) {
      return;
    }
    if (typeof data !== "string") {
      this.counts.received_bytes += data.byteLength;
      this.handlers.frame(data);
      return;
    }
    this.counts.received_bytes += data.length;
    let message = null;
    try {
      message = JSON.parse(data);
    } catch {
      // No object of ours: the next message may be one.
      return;
    }
    if (message !== null && typeof message.type === "string") {
      this.tries = message.type === "welcome" || message.type === "waiting" ? 0 : this.tries;
      this.handlers.message(message);
    }
  }

  closed(socket, event) {
    if (socket !== this.socket) {
      return;
    }
    this.socket = null;
    if (event.code === CLOSE_BAD_TOKEN) {
      this.handlers.state("refused");
      return;
    }
    this.handlers.state("lost");
    const wait = BACK_OFF_MS[Math.min(this.tries, BACK_OFF_MS.length - 1)];
    this.tries += 1;
    this.timer = setTimeout(() => this.open(), wait);
  }

  /** Takes a token that has come into the address: tries it at once where the one before was refused. */
  renew() {
    const before = this.token;
    this.token = take_token();
    if (this.token !== before && this.socket === null && this.timer === null) {
      this.tries = 0;
      this.open();
    }
  }

  get is_open() {
    return this.socket !== null && this.socket.readyState === WebSocket.OPEN;
  }

  /** True while so much waits to be sent that a newer camera had better replace the one that waits. */
  get is_behind() {
    return this.is_open && this.socket.bufferedAmount > BACKLOG_MAX_BYTES;
  }

  /** Sends `message`; false when there is no connection. */
  send(message) {
    if (!this.is_open) {
      return false;
    }
    this.counts.sent_messages += 1;
    this.socket.send(JSON.stringify(message));
    return true;
  }

  /** Sends an event with the next `seq`; gives that number. */
  send_event(message) {
    this.seq += 1;
    this.send({ ...message, seq: this.seq });
    return this.seq;
  }

  /** Drops the socket, as a network that fails would. */
  drop() {
    this.socket?.close();
  }
}
