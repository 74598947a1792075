// What a hand drags, as this page wishes it: a state from before the newest wish does not put it back.
//
// Invariant: a wish holds from the moment it is made; it is sent with an event some time later, and a state that is
// told as of that event, or of a later one, knows of it.

export class Wishes {
  constructor() {
    this.newest = new Map();
  }

  /** What `key` is has changed here, and is still to be sent. */
  made(key) {
    this.newest.set(key, Infinity);
  }

  /** It is sent, as event `seq`. */
  sent(key, seq) {
    if (this.newest.has(key)) {
      this.newest.set(key, seq);
    }
  }

  /** The server says all anew, or another page drives. */
  forget() {
    this.newest.clear();
  }

  /** True when a state as of event `seq` does not know the newest wish for `key`. */
  is_unknown_to(seq, key) {
    return seq < (this.newest.get(key) ?? 0);
  }
}
