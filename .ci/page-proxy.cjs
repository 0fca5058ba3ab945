// A poor link for the checks of the operator's page: a proxy between the page and the bridge, on this machine.

const net = require("node:net");

/** A lost packet is sent again after this time (Linux's shortest, RFC 6298), ms, and what is behind it waits as long. */
const RETRANSMISSION_MS = 200;

/** A proxy that delays, loses and holds what passes. What TCP loses comes late: nothing is left out. */
class Proxy {
  /** @param {{delayMs?: number, loss?: number}} link delay of each way, and share of the packets that are lost */
  constructor(target, { delayMs = 0, loss = 0 } = {}) {
    Object.assign(this, { target, delayMs, loss, pairs: new Set(), heldUntil: 0 });
    // The same losses in every run.
    this.random = 12345;
    this.server = net.createServer({ noDelay: true, allowHalfOpen: true }, (client) => this.accept(client));
  }

  async listen() {
    await new Promise((resolve) => { this.server.listen(0, "127.0.0.1", resolve); });
    return this.server.address().port;
  }

  accept(client) {
    const bridge = net.connect({ port: this.target, host: "127.0.0.1", noDelay: true, allowHalfOpen: true });
    const pair = [client, bridge];
    this.pairs.add(pair);
    this.pass(client, bridge);
    this.pass(bridge, client);
    // A connection that breaks is broken on both sides at once; one that ends does so behind what it has sent.
    const destroy = () => {
      pair.forEach((socket) => socket.destroy());
      this.pairs.delete(pair);
    };
    pair.forEach((socket) => socket.on("error", destroy));
    pair.forEach((socket) => socket.on("close", () => { if (pair.every((each) => each.destroyed)) this.pairs.delete(pair); }));
  }

  isLost() {
    this.random = (Math.imul(this.random, 1664525) + 1013904223) >>> 0;
    return this.random / 2 ** 32 < this.loss;
  }

  /** Passes bytes on in order: each as late as the link makes it, and not before those in front of it. */
  pass(from, to) {
    const waiting = [];
    let free = 0;
    let timer = null;
    const send = () => {
      timer = null;
      const now = performance.now();
      while (waiting.length > 0 && Math.max(waiting[0].at, this.heldUntil) <= now) {
        const { data } = waiting.shift();
        if (to.destroyed) continue;
        if (data) to.write(data);
        else to.end();
      }
      if (waiting.length > 0) timer = setTimeout(send, Math.max(waiting[0].at, this.heldUntil) - now);
    };
    /** Passes data on; `null` is the end. */
    const receive = (data) => {
      free = Math.max(free, performance.now() + this.delayMs + (this.isLost() ? RETRANSMISSION_MS : 0));
      waiting.push({ at: free, data });
      timer ??= setTimeout(send, free - performance.now());
    };
    from.on("data", receive);
    from.on("end", () => receive(null));
  }

  /** Lets nothing pass for so long. */
  hold(ms) { this.heldUntil = performance.now() + ms; }

  /** Breaks all connections. */
  breakAll() { for (const [client, bridge] of this.pairs) { client.destroy(); bridge.destroy(); } }

  close() {
    this.breakAll();
    this.server.close();
  }
}

module.exports = { Proxy };
