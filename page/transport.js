// A connection to the bridge: the Foxglove WebSocket protocol, with messages in ROS 2's encoding.

import { RunClock } from "./clock.js";

/** Names of the protocol, the preferred first. */
const PROTOCOLS = ["foxglove.sdk.v1.1", "foxglove.sdk.v1"];
/** First byte of a message on a subscription, and of one that a client publishes. */
const MESSAGE = 1;
/** First byte of a message that says when it was sent: the bridge refuses it if it comes late. */
const TIMED_MESSAGE = 128;
/** Bytes before the payload: kind, subscription, time. */
const MESSAGE_HEADER_BYTES = 13;
/** Pause before the next attempt to connect, ms: the first after a connection that lasted, and at most. It doubles with each attempt that fails. */
const RECONNECT_FIRST_MS = 100;
const RECONNECT_MAX_MS = 500;
/** A connection that breaks sooner, ms, counts as an attempt that failed: a bridge may accept and refuse at once. */
const LASTED_MS = 1000;
/** An attempt to connect that takes longer is given up, ms: after a lost packet it would take many seconds. */
const CONNECT_MAX_MS = 2000;
/** The parameter with the run's time, seconds. */
const TIME_PARAMETER = "/mr_slam/time";
/** The parameter with the bridge's own time, seconds. */
const CLOCK_PARAMETER = "/mr_slam/clock";
/** A connection on which nothing comes for so long is closed and opened again, ms: the bridge answers once a second. */
const SILENCE_MAX_MS = 5000;
/** Commands are not sent while so many bytes wait: they would arrive too late. */
const WAITING_MAX = 4096;

/**
 * @typedef {object} Handlers
 * @property {(topic: string, view: DataView) => void} message a message on a topic that was subscribed to
 * @property {(channels: {topic: string, schemaName: string}[]) => void} [topics] all topics, after a change
 * @property {(isOpen: boolean) => void} [state] the connection is there, or is not
 * @property {(run: string) => void} [run] the bridge has said on this connection to which run of the fleet it belongs, before all else
 * @property {(level: number, text: string) => void} [status] a text for the operator
 * @property {(name: string, value: any) => void} [parameter] a parameter has changed
 * @property {(askedAt: number, answeredAt: number, runTime: number) => void} [time] the run's time, s, between two times of the page, ms
 */

/** A connection that is opened again whenever it breaks. Subscriptions and publications are kept. */
export class Connection {
  /** @param {string} url @param {Handlers} handlers @param {typeof WebSocket} [Socket] */
  constructor(url, handlers, Socket = WebSocket) {
    this.url = url;
    this.handlers = handlers;
    this.Socket = Socket;
    /** @type {Map<string, {id: number, isSent: boolean}>} */
    this.subscriptions = new Map();
    /** Topics by the numbers of their subscriptions. @type {Map<number, string>} */
    this.topics = new Map();
    /** What is published; told to the bridge with the first message on each connection. @type {Map<string, {id: number, schemaName: string, isSent: boolean}>} */
    this.publications = new Map();
    /** @type {Map<number, {topic: string, schemaName: string}>} */
    this.channels = new Map();
    this.wantsParameters = false;
    this.nextId = 1;
    this.isOpen = false;
    /** Identity of the fleet's run; null until the bridge has said it on this connection, empty if it does not say it. @type {string | null} */
    this.run = null;
    /** The pause before the next attempt to connect, ms. */
    this.pauseMs = RECONNECT_FIRST_MS;
    /** When something came last, ms of the page. */
    this.heardAt = 0;
    /** When the newest attempt to connect began, ms of the page. */
    this.begunAt = 0;
    /** The question for the run's time that is not answered yet. @type {{id: string, at: number} | null} */
    this.asked = null;
    /** The bridge's own clock, as this connection knows it. */
    this.clock = new RunClock();
    this.connect();
  }

  connect() {
    this.begunAt = performance.now();
    const socket = new this.Socket(this.url, PROTOCOLS);
    socket.binaryType = "arraybuffer";
    /** @type {WebSocket | null} */
    this.socket = socket;
    socket.onopen = () => { if (socket === this.socket) this.opened(); };
    socket.onmessage = (event) => {
      if (socket !== this.socket) return;
      this.heardAt = performance.now();
      if (typeof event.data === "string") this.receiveText(event.data);
      else this.receiveBinary(event.data);
    };
    socket.onclose = () => {
      if (socket === this.socket) this.closed();
    };
  }

  closed() {
    const hasLasted = this.isOpen && performance.now() - this.begunAt >= LASTED_MS;
    if (hasLasted) this.pauseMs = RECONNECT_FIRST_MS;
    this.isOpen = false;
    this.socket = null;
    this.handlers.state?.(false);
    setTimeout(() => this.connect(), this.pauseMs);
    this.pauseMs = Math.min(2 * this.pauseMs, RECONNECT_MAX_MS);
  }

  /** Asks for the run's time, and gives up a connection on which nothing comes any more. Call it once a second. */
  tick(now = performance.now()) {
    if (!this.isOpen) {
      if (this.socket && now - this.begunAt > CONNECT_MAX_MS) {
        this.socket.close();
        this.closed();
      }
      return;
    }
    if (now - this.heardAt > SILENCE_MAX_MS) {
      // A link that is gone without a word: closing waits for the other side, so the socket is not waited for.
      this.socket?.close();
      this.closed();
    } else if (!this.asked) {
      this.asked = { id: `time ${this.nextId++}`, at: now };
      this.sendJson({ op: "getParameters", parameterNames: [TIME_PARAMETER, CLOCK_PARAMETER], id: this.asked.id });
    }
  }

  /** Returns for how long nothing has come, ms. */
  silence(now = performance.now()) { return this.isOpen ? now - this.heardAt : 0; }

  opened() {
    this.isOpen = true;
    this.heardAt = performance.now();
    this.asked = null;
    this.clock.reset();
    this.run = null;
    this.channels.clear();
    for (const subscription of this.subscriptions.values()) subscription.isSent = false;
    for (const publication of this.publications.values()) publication.isSent = false;
    if (this.wantsParameters) this.sendJson({ op: "subscribeParameterUpdates", parameterNames: [] });
    this.handlers.state?.(true);
    // Ages need the run's time at once.
    this.tick(this.heardAt);
  }

  sendJson(/** @type {object} */ message) {
    if (this.isOpen) this.socket?.send(JSON.stringify(message));
  }

  receiveText(/** @type {string} */ data) {
    const message = JSON.parse(data);
    if (message.op === "serverInfo") {
      const run = String(message.metadata?.run ?? "");
      this.run = run;
      this.handlers.run?.(run);
    } else if (message.op === "advertise") {
      for (const { id, topic, schemaName } of message.channels) this.channels.set(id, { topic, schemaName });
      this.sendSubscriptions();
    } else if (message.op === "unadvertise") {
      for (const id of message.channelIds) {
        const subscription = this.subscriptions.get(this.channels.get(id)?.topic ?? "");
        if (subscription) subscription.isSent = false;
        this.channels.delete(id);
      }
    } else if (message.op === "status") {
      this.handlers.status?.(message.level, message.message);
    } else if (message.op === "parameterValues" && this.asked && this.asked.id === message.id) {
      const { at } = this.asked;
      this.asked = null;
      this.receiveTimes(at, performance.now(), message.parameters);
    } else if (message.op === "parameterValues") {
      for (const { name, value } of message.parameters) this.handlers.parameter?.(name, value);
    }
    if (message.op === "advertise" || message.op === "unadvertise") {
      this.handlers.topics?.([...this.channels.values()]);
    }
  }

  /** Takes the bridge's answer to the question for its times. @param {number} askedAt @param {number} answeredAt ms of the page @param {{name: string, value: any}[]} parameters */
  receiveTimes(askedAt, answeredAt, parameters) {
    for (const { name, value } of parameters) {
      if (typeof value !== "number") continue;
      if (name === CLOCK_PARAMETER) this.clock.add(askedAt / 1000, answeredAt / 1000, value);
      else if (name === TIME_PARAMETER) this.handlers.time?.(askedAt, answeredAt, value);
    }
  }

  receiveBinary(/** @type {ArrayBuffer} */ data) {
    const view = new DataView(data);
    if (data.byteLength < MESSAGE_HEADER_BYTES || view.getUint8(0) !== MESSAGE) return;
    const topic = this.topics.get(view.getUint32(1, true));
    if (topic !== undefined) this.handlers.message(topic, new DataView(data, MESSAGE_HEADER_BYTES));
  }

  /** Subscribes to a topic, at once or as soon as there is one of this name. */
  subscribe(/** @type {string} */ topic) {
    if (this.subscriptions.has(topic)) return;
    this.topics.set(this.nextId, topic);
    this.subscriptions.set(topic, { id: this.nextId++, isSent: false });
    this.sendSubscriptions();
  }

  /** Ends a subscription, if there is one. */
  unsubscribe(/** @type {string} */ topic) {
    const subscription = this.subscriptions.get(topic);
    if (!subscription) return;
    this.subscriptions.delete(topic);
    this.topics.delete(subscription.id);
    if (subscription.isSent) this.sendJson({ op: "unsubscribe", subscriptionIds: [subscription.id] });
  }

  /** Subscribes to everything anew, so that latched messages come again. */
  renew() {
    for (const topic of [...this.subscriptions.keys()]) {
      this.unsubscribe(topic);
      this.subscribe(topic);
    }
  }

  sendSubscriptions() {
    const subscriptions = [];
    for (const [channelId, { topic }] of this.channels) {
      const subscription = this.subscriptions.get(topic);
      if (subscription && !subscription.isSent) {
        subscription.isSent = true;
        subscriptions.push({ id: subscription.id, channelId });
      }
    }
    if (subscriptions.length > 0) this.sendJson({ op: "subscribe", subscriptions });
  }

  /** Asks to be told of parameters. */
  subscribeParameters() {
    this.wantsParameters = true;
    this.sendJson({ op: "subscribeParameterUpdates", parameterNames: [] });
  }

  /** @param {string} topic @param {{id: number, schemaName: string, isSent: boolean}} publication */
  sendAdvertise(topic, publication) {
    publication.isSent = true;
    const channel = { id: publication.id, topic, encoding: "cdr", schemaName: publication.schemaName };
    this.sendJson({ op: "advertise", channels: [channel] });
  }

  /**
   * Publishes a message. Returns false if it cannot be sent now; it is not sent later.
   * @param {string} topic @param {string} schemaName @param {Uint8Array} payload
   * @param {boolean} [isLateWorthy] send it whatever waits, and let the bridge take it however late it comes. Any other message
   * carries the time of its sending: the bridge refuses it if it comes late.
   */
  publish(topic, schemaName, payload, isLateWorthy = false) {
    let publication = this.publications.get(topic);
    if (!publication) {
      publication = { id: this.nextId++, schemaName, isSent: false };
      this.publications.set(topic, publication);
    }
    if (!this.isOpen || !this.socket) return false;
    const sentAt = isLateWorthy ? null : this.clock.toBridge(performance.now() / 1000);
    if (!isLateWorthy && (sentAt === null || this.socket.bufferedAmount > WAITING_MAX)) return false;
    if (!publication.isSent) this.sendAdvertise(topic, publication);
    this.socket.send(clientMessage(publication.id, sentAt, payload));
    return true;
  }
}

/** Returns a message for the bridge. @param {number} id of the publication @param {number | null} sentAt when it is sent, seconds of the bridge, or null not to say so @param {Uint8Array} payload */
function clientMessage(id, sentAt, payload) {
  const headerBytes = sentAt === null ? 5 : 13;
  const message = new Uint8Array(headerBytes + payload.length);
  const view = new DataView(message.buffer);
  view.setUint8(0, sentAt === null ? MESSAGE : TIMED_MESSAGE);
  view.setUint32(1, id, true);
  if (sentAt !== null) view.setBigUint64(5, BigInt(Math.max(0, Math.round(sentAt * 1e9))), true);
  message.set(payload, headerBytes);
  return message;
}
