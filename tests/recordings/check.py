"""Records a demo, and reads the recording with rosbags and mcap-ros2-support: counts, bytes, payloads, split files,
a recorder that was killed. usage: check.py MR_SLAM OUT"""
import collections, json, os, pathlib, shutil, signal, socket, struct, subprocess, sys, threading, time

import attached
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import Reader as BagReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from ruamel.yaml import YAML

PROGRAM, OUT = sys.argv[1], pathlib.Path(sys.argv[2]).absolute()
FOLDER = OUT / "recordings"
SECONDS = float(os.environ.get("SECONDS_RECORDED", "12"))
# Topics whose payloads are compared with those that a TCP client receives.
COMPARED = {"/robot1/scan": "sensor_msgs/LaserScan", "/robot2/odom": "nav_msgs/Odometry", "/clock": "rosgraph_msgs/Clock"}
failures = []


def check(name, is_so, detail=""):
    print(f"{'ok  ' if is_so else 'FAIL'} {name} {detail}")
    if not is_so:
        failures.append(name)


class TcpClient(threading.Thread):
    """Subscribes to topics and keeps their payloads."""

    def __init__(self, port):
        super().__init__(daemon=True)
        self.payloads = collections.defaultdict(list)
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=5)
        for topic, kind in COMPARED.items():
            body = json.dumps({"topic": topic, "message_name": kind}).encode() 
            name = b"__subscribe"
            self.socket.sendall(struct.pack("<I", len(name)) + name + struct.pack("<I", len(body)) + body)

    def read(self, length):
        parts = b""
        while len(parts) < length:
            part = self.socket.recv(length - len(parts))
            if not part:
                raise ConnectionError
            parts += part
        return parts

    def run(self):
        try:
            while True:
                topic = self.read(struct.unpack("<I", self.read(4))[0]).decode()
                payload = self.read(struct.unpack("<I", self.read(4))[0])
                self.payloads[topic].append(payload)
        except (ConnectionError, OSError):
            pass


def yaml_of(text):
    """Returns what a text in YAML says."""
    return YAML(typ="safe").load(text) or {}


def stamp_s(clock):
    """Returns the time of an encoded rosgraph_msgs/Clock, seconds."""
    seconds, nanoseconds = struct.unpack("<iI", clock[4:12])
    return seconds + nanoseconds * 1e-9


def wait_for(path, seconds=20):
    until = time.monotonic() + seconds
    while not path.exists():
        if time.monotonic() > until:
            raise TimeoutError(path)
        time.sleep(0.05)


def raw_messages(path):
    """Topic -> payloads, by the mcap package, from the beginning of the file: no index is needed."""
    payloads, channels = collections.defaultdict(list), {}
    try:
        for record in StreamReader(open(path, "rb"), validate_crcs=True).records:
            if type(record).__name__ == "Channel":
                channels[record.id] = record.topic
            elif type(record).__name__ == "Message":
                payloads[channels[record.channel_id]].append(record.data)
    except Exception as why:  # a file that was cut off ends in the middle of a record
        return payloads, f"{type(why).__name__}: {why}"
    return payloads, None


def decode_with_mcap_ros2(path):
    counts = collections.Counter()
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        summary = reader.get_summary()
        for _, channel, _, message in reader.iter_decoded_messages():
            counts[channel.topic] += 1
            if channel.topic == "/robot1/scan" and counts[channel.topic] == 1:
                check("a scan has its beams", len(message.ranges) > 100 and message.header.frame_id == "base_scan_1",
                      f"{len(message.ranges)} beams in {message.header.frame_id}")
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
    return counts, summary, metadata


def decode_with_rosbags(path):
    """The schemas in the file are the types: nothing of ROS is installed."""
    counts = collections.Counter()
    store = get_typestore(Stores.EMPTY)
    bag = path.parent / (path.stem + "_bag")
    shutil.rmtree(bag, ignore_errors=True)
    bag.mkdir()
    shutil.copy(path, bag / path.name)
    raw, _ = raw_messages(path)
    with open(path, "rb") as file:
        summary = make_reader(file).get_summary()
    kinds = {channel.topic: (summary.schemas[channel.schema_id].name, channel.metadata["offered_qos_profiles"])
             for channel in summary.channels.values()}
    statistics = summary.statistics
    topics = [{"topic_metadata": {"name": topic, "type": kind, "serialization_format": "cdr",
               "offered_qos_profiles": qos}, "message_count": len(raw.get(topic, []))} for topic, (kind, qos) in kinds.items()]
    start, end = statistics.message_start_time, statistics.message_end_time
    info = {"rosbag2_bagfile_information": {
        "version": 5, "storage_identifier": "mcap", "relative_file_paths": [path.name],
        "duration": {"nanoseconds": end - start}, "starting_time": {"nanoseconds_since_epoch": start},
        "message_count": statistics.message_count, "topics_with_message_count": topics,
        "compression_format": "", "compression_mode": ""}}
    (bag / "metadata.yaml").write_text(json.dumps(info))
    for schema in summary.schemas.values():
        store.register({k: v for k, v in get_types_from_msg(schema.data.decode(), schema.name).items()
                        if k not in store.types})
    with BagReader(bag) as reader:
        for connection, _, payload in reader.messages():
            store.deserialize_cdr(payload, connection.msgtype)
            counts[connection.topic] += 1
    return counts


def messages_of_folder(folder):
    """Returns the number of messages of a bag, as read and as its description says."""
    with BagReader(folder) as reader:
        return sum(1 for _ in reader.messages()), reader.message_count


def demo(folder, *options, seconds=SECONDS):
    shutil.rmtree(folder, ignore_errors=True)
    log = open(OUT / f"{folder.name}.log", "w")
    return subprocess.Popen([PROGRAM, "demo", "--robots", "2", "--port", "0", "--page", "off", "--seconds", str(seconds),
                             "--run-dir", str(folder), "--record", *options], stdout=log, stderr=log)


def main():
    FOLDER.mkdir(parents=True, exist_ok=True)
    run = FOLDER / "run"
    process = demo(run)
    wait_for(run / "run.json")
    client = TcpClient(json.loads((run / "run.json").read_text())["port"])
    client.start()
    check("the demo ends well", process.wait(timeout=SECONDS + 60) == 0)
    told = json.loads((run / "recording/recording.json").read_text())
    told_counts = {topic["topic"]: (topic["messages"], topic["bytes"]) for topic in told["topics"] if topic["messages"]}
    path = pathlib.Path(told["files"][0])
    check("one file, nothing dropped", len(told["files"]) == 1 and told["dropped"] == 0, f"{told['lost']} lost")

    raw, broken = raw_messages(path)
    read = {topic: (len(payloads), sum(map(len, payloads))) for topic, payloads in raw.items()}
    check("the file is whole", broken is None, broken or "")
    check("counts and bytes are the recorder's", read == told_counts, f"{sum(n for n, _ in read.values())} messages on {len(read)} topics")
    counts, summary, metadata = decode_with_mcap_ros2(path)
    check("mcap-ros2-support decodes every message", dict(counts) == {t: n for t, (n, _) in read.items()})
    check("its index counts them too", summary.statistics.message_count == sum(counts.values()))
    check("configuration, room, seed, version and machine are in it",
          {"configuration", "room", "seed", "version", "machine"} <= set(metadata.get("mr_slam", {})))
    described = yaml_of(metadata.get("rosbag2", {}).get("serialized_metadata", "")).get("rosbag2_bagfile_information", {})
    check("rosbag2 reads the policies of its topics as numbers", described.get("version") == 5, str(described))
    counts = decode_with_rosbags(path)
    differing = {t: (n, counts[t]) for t, (n, _) in read.items() if counts[t] != n}
    check("rosbags decodes every message", not differing, str(differing or ""))
    check("rosbags reads the folder as one bag, by its metadata.yaml", messages_of_folder(run / "recording") == (sum(counts.values()),) * 2)
    for topic in ["/tf", "/tf_static", "/robot1/map", "/merged_map", "/robot1/cmd_vel", "/robot1/pose", "/fleet_stats",
                  "/operator_state", "/selected_robot", "/emergency_stop", "/robot2/ground_truth", "/merge_edges", "/robot1/slam_stats",
                  "/robot1/odom_2d", "/robot1/cmd_vel_sender", "/operator_event", "/exclusion_zones", "/explore/state"]:
        check(f"{topic} is recorded", topic in read)
    for topic in COMPARED:
        # Covariances of odometry grow with the way since the reader's first message: they are left out.
        known = -8 * (36 + 6 + 36) if "odom" in topic else None
        received, recorded = client.payloads[topic], {payload[:known] for payload in raw[topic]}
        is_in = [payload[:known] in recorded for payload in received]
        # Neither end need be there for the other's first and last messages.
        both = is_in[is_in.index(True):len(is_in) - is_in[::-1].index(True)] if True in is_in else []
        check(f"what a TCP client got of {topic} is in the recording, byte for byte",
              len(both) > 5 * SECONDS and both.count(False) <= told["lost"],
              f"{len(both)} of {len(received)} messages, {both.count(False)} missing")

    # A recorder that is killed: what is on disk can be read but for the last second, and the fleet goes on.
    killed = FOLDER / "killed"
    process = demo(killed, seconds=SECONDS)
    wait_for(killed / "recording/recording.mcap")
    time.sleep(SECONDS / 2)
    pids = subprocess.run(["pgrep", "-f", f"worker record --run-dir {killed}"], capture_output=True, text=True).stdout.split()
    check("there is one recorder", len(pids) == 1, str(pids))
    for pid in pids:
        os.kill(int(pid), signal.SIGKILL)
    check("the fleet ends well", process.wait(timeout=SECONDS + 60) == 0)
    first, broken = raw_messages(killed / "recording/recording.mcap")
    times = len(first["/clock"]) / 100
    check("what the killed recorder wrote can be read", times > SECONDS / 2 - 2.5, f"{times:.1f} s; {broken}")
    second, broken = raw_messages(killed / "recording/recording_1.mcap")
    check("its replacement records on in another file", broken is None and len(second["/clock"]) > 100)
    summary = json.loads((killed / "recording/recording.json").read_text())
    names = {key: [pathlib.Path(name).name for name in summary[key]] for key in ("earlier", "files")}
    check("its summary names the file of the killed one apart", names == {"earlier": ["recording.mcap"], "files": ["recording_1.mcap"]}, str(names))
    lost_s = stamp_s(second["/clock"][0]) - stamp_s(first["/clock"][-1])
    check("a kill loses a second at most, and the time until the recorder is back", lost_s < 1.5, f"{lost_s:.2f} s")
    readers = [lambda path: decode_with_mcap_ros2(path)[0], decode_with_rosbags]
    attached.check_all(PROGRAM, FOLDER, check, raw_messages, wait_for, readers)
    lines = sum(topic["messages"] for topic in told["topics"])
    print(f"{'failed: ' + ', '.join(failures) if failures else f'all checked, {lines} messages'}")
    return 1 if failures else 0


sys.exit(main())
