// The connection to the bridge, with a socket of the test's.

import assert from "node:assert/strict";
import { test } from "node:test";
import { Connection } from "../transport.js";

/** A socket that remembers what is sent. */
class FakeSocket {
  static all = [];
  constructor(url, protocols) {
    Object.assign(this, { url, protocols, sent: [], bufferedAmount: 0 });
    FakeSocket.all.push(this);
  }
  send(data) { this.sent.push(data); }
  receive(message) { this.onmessage({ data: JSON.stringify(message) }); }
  commands(op) { return this.sent.filter((data) => typeof data === "string").map(JSON.parse).filter((m) => m.op === op); }
}

function open(handlers = {}) {
  FakeSocket.all = [];
  const connection = new Connection("ws://localhost:8080/", { message() {}, ...handlers }, FakeSocket);
  const [socket] = FakeSocket.all;
  socket.onopen();
  return { connection, socket };
}

/** Tells a connection the bridge's own time: then commands can say when they are sent. */
function tellTime(socket, seconds = 100) {
  const { id } = socket.commands("getParameters").at(-1);
  socket.receive({ op: "parameterValues", id, parameters: [{ name: "/mr_slam/clock", value: seconds }] });
}

const ADVERTISE = { op: "advertise", channels: [{ id: 9, topic: "/robot1/scan", schemaName: "sensor_msgs/msg/LaserScan" }] };

test("a topic is subscribed to once it is there, and its messages arrive", () => {
  const received = [];
  const { connection, socket } = open({ message: (topic, view) => received.push([topic, view.getUint8(0)]) });
  connection.subscribe("/robot1/scan");
  assert.deepEqual(socket.commands("subscribe"), []);
  socket.receive(ADVERTISE);
  const [{ subscriptions: [{ id, channelId }] }] = socket.commands("subscribe");
  assert.equal(channelId, 9);
  const data = new Uint8Array(14);
  data[0] = 1;
  new DataView(data.buffer).setUint32(1, id, true);
  data[13] = 42;
  socket.onmessage({ data: data.buffer });
  assert.deepEqual(received, [["/robot1/scan", 42]]);
  socket.onmessage({ data: new ArrayBuffer(3) });
  assert.equal(received.length, 1);
});

test("a publication is announced once, and old commands do not pile up", () => {
  const { connection, socket } = open();
  assert.equal(connection.publish("/robot1/cmd_vel", "geometry_msgs/msg/Twist", new Uint8Array([7])), false, "the bridge's time is not known yet");
  tellTime(socket);
  const send = (isUrgent) => connection.publish("/robot1/cmd_vel", "geometry_msgs/msg/Twist", new Uint8Array([7]), isUrgent);
  assert.equal(send(), true);
  assert.equal(send(), true);
  assert.equal(socket.commands("advertise").length, 1);
  const messages = () => socket.sent.filter((data) => data instanceof Uint8Array);
  const { id } = connection.publications.get("/robot1/cmd_vel");
  assert.deepEqual([...messages()[0].slice(0, 5), ...messages()[0].slice(13)], [128, id, 0, 0, 0, 7]);
  const sentAt = Number(new DataView(messages()[0].buffer).getBigUint64(5, true)) * 1e-9;
  assert.ok(sentAt >= 100 && sentAt < 110, `the bridge's time, ${sentAt}`);
  socket.bufferedAmount = 1e6;
  assert.equal(send(), false);
  assert.equal(send(true), true, "an emergency stop is sent whatever waits");
  assert.deepEqual([...messages()[2]], [1, id, 0, 0, 0, 7], "and is carried out however late it comes");
  assert.equal(messages().length, 3);
});

test("a new connection gets the subscriptions and publications of the one before", (t) => {
  t.mock.timers.enable({ apis: ["setTimeout"] });
  const states = [];
  const { connection, socket } = open({ state: (isOpen) => states.push(isOpen) });
  connection.subscribe("/robot1/scan");
  connection.publish("/robot1/cmd_vel", "geometry_msgs/msg/Twist", new Uint8Array([7]));
  socket.receive(ADVERTISE);
  socket.onclose();
  assert.equal(connection.publish("/robot1/cmd_vel", "geometry_msgs/msg/Twist", new Uint8Array([7])), false);
  t.mock.timers.tick(1000);
  const again = FakeSocket.all[1];
  again.onopen();
  again.receive(ADVERTISE);
  assert.equal(again.commands("subscribe").length, 1);
  assert.equal(again.commands("advertise").length, 0, "another run may have no such topic");
  assert.deepEqual(states, [true, false, true]);
  assert.equal(again.sent.some((data) => data instanceof Uint8Array), false, "no command is sent late");
  tellTime(again);
  connection.publish("/robot1/cmd_vel", "geometry_msgs/msg/Twist", new Uint8Array([7]));
  connection.publish("/robot1/cmd_vel", "geometry_msgs/msg/Twist", new Uint8Array([7]));
  const sent = again.sent.slice(-3).map((data) => (typeof data === "string" ? JSON.parse(data).op : "message"));
  assert.deepEqual(sent, ["advertise", "message", "message"]);
});

/** Returns the pauses before the next attempts, ms: each connection is closed after so long, and was open or was not. */
function pauses(t, closedAfterMs, isAccepted) {
  t.mock.timers.enable({ apis: ["setTimeout"] });
  let now = 0;
  t.mock.method(performance, "now", () => now);
  FakeSocket.all = [];
  new Connection("ws://localhost:8080/", { message() {} }, FakeSocket);
  return closedAfterMs.map((openMs) => {
    const socket = FakeSocket.all.at(-1);
    if (isAccepted) socket.onopen();
    now += openMs;
    socket.onclose();
    const closedAt = now;
    while (FakeSocket.all.at(-1) === socket && now < closedAt + 1000) {
      now += 1;
      t.mock.timers.tick(1);
    }
    return now - closedAt;
  });
}

test("a bridge that accepts and refuses at once is soon asked twice a second", (t) => {
  assert.deepEqual(pauses(t, [10, 10, 10, 10, 10], true), [100, 200, 400, 500, 500]);
});

test("after a connection that lasted the pause is short again", (t) => {
  assert.deepEqual(pauses(t, [10, 10, 999, 1000, 10], true), [100, 200, 400, 100, 200]);
});

test("attempts that fail are made twice a second, however long each took", (t) => {
  assert.deepEqual(pauses(t, [10, 10, 2000, 2000, 10], false), [100, 200, 400, 500, 500]);
});

test("the run's time is asked for one question at a time, and a silent connection is opened again", async () => {
  const times = [];
  const told = [];
  const { connection, socket } = open({ time: (...time) => times.push(time), parameter: (...parameter) => told.push(parameter) });
  const begun = performance.now();
  connection.tick(begun);
  connection.tick(begun + 1000);
  const [{ parameterNames, id }, ...more] = socket.commands("getParameters");
  assert.deepEqual([parameterNames, more], [["/mr_slam/time", "/mr_slam/clock"], []], "the first is not answered yet");
  socket.receive({ op: "parameterValues", id: "another", parameters: [{ name: "/mr_slam/time", value: 1 }] });
  socket.receive({ op: "parameterValues", id, parameters: [{ name: "/mr_slam/time", value: 42.5 }] });
  assert.equal(times.length, 1);
  assert.equal(times[0][2], 42.5);
  // What the bridge tells by itself has no id; it is no answer, though none is waited for.
  socket.receive({ op: "parameterValues", parameters: [{ name: "/mr_slam/fleet", value: 7 }] });
  assert.deepEqual(told, [["/mr_slam/time", 1], ["/mr_slam/fleet", 7]]);
  connection.tick(begun + 2000);
  assert.equal(socket.commands("getParameters").length, 2);
  let isClosed = false;
  socket.close = () => { isClosed = true; };
  connection.tick(begun + 60_000);
  assert.deepEqual([isClosed, connection.isOpen], [true, false]);
  await new Promise((resolve) => { setTimeout(resolve, 600); });
  assert.equal(FakeSocket.all.length, 2);
  socket.onclose();
  FakeSocket.all[1].onopen();
  assert.equal(connection.isOpen, true, "what the old socket still says does not matter");
});

test("a subscription that is ended can be made again", () => {
  const { connection, socket } = open();
  socket.receive(ADVERTISE);
  connection.subscribe("/robot1/scan");
  const [{ subscriptions: [{ id }] }] = socket.commands("subscribe");
  connection.unsubscribe("/robot1/scan");
  connection.unsubscribe("/robot1/scan");
  assert.deepEqual(socket.commands("unsubscribe").map((message) => message.subscriptionIds), [[id]]);
  connection.subscribe("/robot1/scan");
  assert.notEqual(socket.commands("subscribe")[1].subscriptions[0].id, id);
});

test("a socket that breaks every 30 s is opened after the same tenth of a second each time", (t) => {
  t.mock.timers.enable({ apis: ["setTimeout"] });
  const { connection } = open();
  connection.subscribe("/robot1/scan");
  for (let round = 1; round <= 10; round += 1) {
    t.mock.timers.tick(30_000);
    connection.begunAt -= 30_000;
    FakeSocket.all.at(-1).onclose();
    t.mock.timers.tick(99);
    assert.equal(FakeSocket.all.length, round);
    t.mock.timers.tick(1);
    const again = FakeSocket.all[round];
    again.onopen();
    again.receive(ADVERTISE);
    assert.equal(again.commands("subscribe").length, 1);
  }
});

test("an attempt to connect that hangs is given up, and another one is made", (t) => {
  t.mock.timers.enable({ apis: ["setTimeout"] });
  FakeSocket.all = [];
  const connection = new Connection("ws://localhost:8080/", { message() {} }, FakeSocket);
  let isClosed = false;
  FakeSocket.all[0].close = () => { isClosed = true; };
  connection.tick(performance.now() + 1000);
  assert.equal(isClosed, false);
  connection.tick(performance.now() + 3000);
  t.mock.timers.tick(500);
  assert.deepEqual([isClosed, FakeSocket.all.length], [true, 2]);
});

test("subscriptions that are renewed are sent anew", () => {
  const { connection, socket } = open();
  connection.subscribe("/robot1/scan");
  socket.receive(ADVERTISE);
  connection.renew();
  assert.equal(socket.commands("unsubscribe").length, 1);
  const ids = socket.commands("subscribe").map(({ subscriptions: [{ id }] }) => id);
  assert.equal(new Set(ids).size, 2);
});

test("each connection says to which run it belongs before all else, and forgets it when it is opened again", (t) => {
  t.mock.timers.enable({ apis: ["setTimeout"] });
  const runs = [];
  const { connection, socket } = open({ run: (run) => runs.push(run) });
  assert.equal(connection.run, null);
  socket.receive({ op: "serverInfo", name: "MR-SLAM", metadata: { run: "7-42" } });
  assert.equal(connection.run, "7-42");
  socket.onclose();
  t.mock.timers.tick(1000);
  FakeSocket.all[1].onopen();
  assert.equal(connection.run, null);
  FakeSocket.all[1].receive({ op: "serverInfo", name: "another server" });
  assert.deepEqual(runs, ["7-42", ""]);
});
