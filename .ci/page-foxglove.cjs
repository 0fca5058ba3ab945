// The bridge as Foxglove's own client library sees it: topics, schemas, messages, parameters, services, and a goal that is published.

const assert = require("node:assert/strict");
const { after, before, test } = require("node:test");
const { FoxgloveClient } = require("@foxglove/ws-protocol");
const { parse } = require("@foxglove/rosmsg");
const { MessageReader, MessageWriter } = require("@foxglove/rosmsg2-serialization");
const WebSocket = require("ws");

const { PAGE_URL: url } = process.env;
/** What has not come by then never comes, ms. */
const WAIT_MS = 30_000;
/** Topics on which a fleet at rest publishes, or has published. */
const EXPECTED = [
  "/robot1/scan", "/robot2/odom", "/robot1/pose", "/robot1/map", "/tf", "/tf_static", "/clock", "/merged_map", "/merge_edges",
  "/robot1/slam_stats", "/selected_robot", "/emergency_stop",
];
let client;
const channels = new Map();
const services = new Map();
const statuses = [];

/** Waits until something is so. */
async function until(what, isSo) {
  const end = Date.now() + WAIT_MS;
  while (!isSo()) {
    assert.ok(Date.now() < end, `waited in vain: ${what}`);
    await new Promise((resolve) => { setTimeout(resolve, 20); });
  }
}

before(async () => {
  client = new FoxgloveClient({ ws: new WebSocket(url.replace("http", "ws"), [FoxgloveClient.SUPPORTED_SUBPROTOCOL, "foxglove.sdk.v1"]) });
  client.on("advertise", (added) => added.forEach((channel) => channels.set(channel.topic, channel)));
  client.on("advertiseServices", (added) => added.forEach((service) => services.set(service.name, service)));
  client.on("status", (status) => statuses.push(status));
  client.on("error", (error) => statuses.push(error));
  await until("topics", () => channels.has("/robot1/scan"));
});
after(() => client.close());

const schemaOf = (topic) => parse(channels.get(topic).schema, { ros2: true });

test("messages of every topic are decoded by their schemas", async () => {
  const received = new Map();
  const readers = new Map();
  const listener = ({ subscriptionId, data }) => {
    const { topic, reader } = readers.get(subscriptionId);
    received.set(topic, reader.readMessage(data));
  };
  client.on("message", listener);
  for (const [topic, { id }] of channels) readers.set(client.subscribe(id), { topic, reader: new MessageReader(schemaOf(topic)) });
  await until("a message on each topic", () => EXPECTED.every((topic) => received.has(topic)));
  assert.equal(received.get("/robot1/scan").header.frame_id, "base_scan_1");
  const map = received.get("/merged_map");
  assert.equal(map.data.length, map.info.width * map.info.height);
  assert.deepEqual(Object.keys(JSON.parse(received.get("/merge_edges").data)).sort(), ["contradicted_starts", "edges", "unsaved"]);
  client.off("message", listener);
  for (const id of readers.keys()) client.unsubscribe(id);
});

test("the fleet's state and the run's time are parameters", async () => {
  const answers = new Map();
  client.on("parameterValues", ({ parameters, id }) => { if (id) answers.set(id, parameters); });
  client.getParameters(["/mr_slam/time"], "time");
  client.getParameters([], "all");
  await until("answers", () => answers.size === 2);
  assert.ok(answers.get("time")[0].value > 0);
  assert.deepEqual(answers.get("all").map(({ name }) => name), ["/mr_slam/fleet", "/mr_slam/time", "/mr_slam/clock"]);
});

test("services are called by their schemas, and a call that cannot be done fails", async () => {
  const calls = new Map();
  client.on("serviceCallResponse", (response) => calls.set(response.callId, response));
  client.on("serviceCallFailure", (failure) => calls.set(failure.callId, failure));
  await until("services", () => services.has("/robot1/slam_toolbox/save_map"));
  const call = (name, callId, request) => {
    const { id: serviceId, request: { schema } } = services.get(name);
    const data = new MessageWriter(parse(schema, { ros2: true })).writeMessage(request);
    client.sendServiceCallRequest({ serviceId, callId, encoding: "cdr", data });
  };
  call("/robot1/clear_closures", 1, {});
  call("/robot1/slam_toolbox/save_map", 2, { name: { data: "../x" } });
  await until("an answer and a failure", () => calls.size === 2);
  const { response } = services.get("/robot1/clear_closures");
  const answer = new MessageReader(parse(response.schema, { ros2: true })).readMessage(calls.get(1).data);
  assert.equal(answer.success, true, answer.message);
  assert.match(calls.get(2).message, /leads out of the folder for saved files/);
});

test("a goal that is published is driven to", async () => {
  const states = [];
  const topic = "/robot1/navigation_state";
  await until("navigation", () => channels.has(topic));
  const reader = new MessageReader(schemaOf(topic));
  const subscription = client.subscribe(channels.get(topic).id);
  client.on("message", ({ subscriptionId, data }) => { if (subscriptionId === subscription) states.push(JSON.parse(reader.readMessage(data).data)); });
  const pose = new MessageWriter(schemaOf("/robot1/goal_pose"));
  const publication = client.advertise({ topic: "/robot1/goal_pose", encoding: "cdr", schemaName: "geometry_msgs/msg/PoseStamped" });
  const goal = pose.writeMessage({
    header: { stamp: { sec: 0, nanosec: 0 }, frame_id: "base_footprint_1" },
    pose: { position: { x: 0.2, y: 0, z: 0 }, orientation: { x: 0, y: 0, z: 0, w: 1 } },
  });
  client.sendMessage(publication, goal);
  await until("a goal that is accepted", () => states.some(({ state }) => ["planning", "driving", "reached"].includes(state)));
  assert.deepEqual(statuses, [], "nothing was refused");
});
