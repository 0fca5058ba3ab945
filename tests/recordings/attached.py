"""Records of a running fleet with `mr-slam record`, replays of it, and a bag that another program made."""
import collections, json, math, pathlib, shutil, subprocess, time

import numpy
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

# The bag from elsewhere: a robot that drives through a room of 8 m x 6 m, with names of its own.
SCAN_TOPIC, ODOMETRY_TOPIC, LASER_FRAME = "/front_laser/scan_filtered", "/wheels/odometry", "front_laser"
ROOM = (-4.0, 4.0, -3.0, 3.0)
BEAMS, RATE_HZ, LENGTH_S = 360, 10, 20.0
LASER_X_M = 0.2


def attached(program, folder, wait_for):
    """Records a fleet of `up` for some seconds while a robot is sent to a place; returns the file and what `record` said."""
    run, path = folder / "attached_run", folder / "attached.mcap"
    shutil.rmtree(run, ignore_errors=True)
    path.unlink(missing_ok=True)
    path.with_suffix(".json").unlink(missing_ok=True)
    log = open(folder / "attached.log", "w")
    fleet = subprocess.Popen([program, "up", "--robots", "2", "--port", "0", "--page", "off", "--seconds", "40",
                              "--run-dir", str(run)], stdout=log, stderr=log)
    try:
        wait_for(run / "run.json")
        time.sleep(4)
        recorder = subprocess.Popen([program, "record", "--run-dir", str(run), "--seconds", "12", "--json", "--out", str(path)],
                                    stdout=subprocess.PIPE, stderr=log, text=True)
        time.sleep(2)
        subprocess.run([program, "goto", "robot1", "0.3,0.1", "--own-map", "--no-wait", "--run-dir", str(run)],
                       stdout=log, stderr=log, timeout=30, check=False)
        told = json.loads(recorder.communicate(timeout=60)[0])
        still_runs = fleet.poll() is None
    finally:
        fleet.terminate()
        fleet.wait(timeout=30)
    return path, told, still_runs


def replayed_twice(program, path):
    """Returns the SHA-256 of the maps of two replays."""
    def replay():
        ended = subprocess.run([program, "replay", str(path), "--json"], capture_output=True, text=True, timeout=600)
        if ended.returncode:
            return f"failed: {ended.stderr.strip()[-200:]}"
        return json.loads(ended.stdout)["maps_sha256"]
    return replay(), replay()


def ranges(x, y, yaw):
    """Distances to the walls of the room, one for each beam, counter-clockwise from straight back."""
    angles = yaw - math.pi + numpy.arange(BEAMS) * (2 * math.pi / BEAMS)
    ex, ey = numpy.cos(angles), numpy.sin(angles)
    with numpy.errstate(divide="ignore"):
        to_x = numpy.where(ex > 0, (ROOM[1] - x) / ex, (ROOM[0] - x) / ex)
        to_y = numpy.where(ey > 0, (ROOM[3] - y) / ey, (ROOM[2] - y) / ey)
    return numpy.minimum(to_x, to_y).astype(numpy.float32)


def foreign_bag(folder):
    """Writes a bag with rosbags: scans, odometry and the laser's transform. Returns its file and the way's end."""
    bag = folder / "elsewhere"
    shutil.rmtree(bag, ignore_errors=True)
    store = get_typestore(Stores.ROS2_HUMBLE)
    of = store.types
    Time, Header = of["builtin_interfaces/msg/Time"], of["std_msgs/msg/Header"]
    Vector, Point = of["geometry_msgs/msg/Vector3"], of["geometry_msgs/msg/Point"]
    Quaternion, Pose = of["geometry_msgs/msg/Quaternion"], of["geometry_msgs/msg/Pose"]
    zero = Vector(0.0, 0.0, 0.0)

    def header(t, frame):
        return Header(Time(int(t), int(t % 1 * 1e9)), frame)

    def turn(yaw):
        return Quaternion(0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))

    with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topics = {name: writer.add_connection(name, kind, typestore=store) for name, kind in [
            (SCAN_TOPIC, "sensor_msgs/msg/LaserScan"), (ODOMETRY_TOPIC, "nav_msgs/msg/Odometry"),
            ("/tf_static", "tf2_msgs/msg/TFMessage")]}

        def write(topic, t, message, kind):
            writer.write(topics[topic], int(t * 1e9), store.serialize_cdr(message, kind))

        begin = 1_700_000_000.0
        laser = of["geometry_msgs/msg/TransformStamped"](
            header(begin, "robot_base"), LASER_FRAME,
            of["geometry_msgs/msg/Transform"](Vector(LASER_X_M, 0.0, 0.0), turn(0.0)))
        write("/tf_static", begin, of["tf2_msgs/msg/TFMessage"]([laser]), "tf2_msgs/msg/TFMessage")
        for index in range(int(LENGTH_S * RATE_HZ)):
            s, t = index / RATE_HZ, begin + 0.1 + index / RATE_HZ
            # A circle of 1.5 m around the middle of the room.
            angle = 0.2 * s
            x, y, yaw = 1.5 * math.cos(angle), 1.5 * math.sin(angle), angle + math.pi / 2
            pose = of["geometry_msgs/msg/PoseWithCovariance"](Pose(Point(x, y, 0.0), turn(yaw)), numpy.zeros(36))
            twist = of["geometry_msgs/msg/TwistWithCovariance"](of["geometry_msgs/msg/Twist"](zero, zero), numpy.zeros(36))
            write(ODOMETRY_TOPIC, t, of["nav_msgs/msg/Odometry"](header(t, "wheel_frame"), "robot_base", pose, twist),
                  "nav_msgs/msg/Odometry")
            scan = of["sensor_msgs/msg/LaserScan"](
                header(t, LASER_FRAME), -math.pi, math.pi - 2 * math.pi / BEAMS, 2 * math.pi / BEAMS, 0.0, 0.1, 0.1, 20.0,
                ranges(x + LASER_X_M * math.cos(yaw), y + LASER_X_M * math.sin(yaw), yaw), numpy.zeros(0, numpy.float32))
            write(SCAN_TOPIC, t, scan, "sensor_msgs/msg/LaserScan")
    return next(bag.glob("*.mcap"))


def replay_foreign(program, folder, *options):
    """Replays the bag and returns its summary as JSON, or why it failed."""
    path = foreign_bag(folder)
    ended = subprocess.run([program, "replay", str(path), "--json", "--map", str(folder / "elsewhere_map"), *options],
                           capture_output=True, text=True, timeout=300)
    return (json.loads(ended.stdout), "") if ended.returncode == 0 else (None, ended.stderr.strip()[-300:])


def known_area(yaml):
    """Returns the size in metres of the occupied cells' bounding box, by map_server's files."""
    text = pathlib.Path(yaml).read_text()
    resolution = float(next(line for line in text.splitlines() if line.startswith("resolution")).split(":")[1])
    data = pathlib.Path(yaml).with_suffix(".pgm").read_bytes()
    fields, at = [], 0
    while len(fields) < 4:
        end = data.index(b"\n", at)
        line, at = data[at:end], end + 1
        if not line.startswith(b"#"):
            fields += line.split()
    width, height = int(fields[1]), int(fields[2])
    cells = numpy.frombuffer(data[at:], numpy.uint8).reshape(height, width)
    rows, columns = numpy.nonzero(cells < 50)
    return (columns.max() - columns.min() + 1) * resolution, (rows.max() - rows.min() + 1) * resolution


def check_all(program, folder, check, raw_messages, wait_for, readers):
    """Runs the checks of this file."""
    path, told, still_runs = attached(program, folder, wait_for)
    raw, broken = raw_messages(path)
    counts = collections.Counter({topic: len(payloads) for topic, payloads in raw.items()})
    check("mr-slam record leaves a whole file and a fleet that runs", broken is None and still_runs, broken or "")
    check("its counts are those that it told",
          dict(counts) == {of["topic"]: of["messages"] for of in told["topics"] if of["messages"]})
    check("scans of 12 s of both robots", all(counts[f"/robot{n}/scan"] > 90 for n in (1, 2)),
          f"{counts['/robot1/scan']}, {counts['/robot2/scan']}")
    for topic in ["/robot1/navigation_command", "/robot1/navigation_state", "/robot1/plan", "/operator_state", "/robot1/cmd_vel"]:
        check(f"{topic} is recorded by mr-slam record", counts[topic] > 0, str(counts[topic]))
    check("mcap-ros2-support and rosbags decode every message of it", all(dict(read(path)) == dict(counts) for read in readers))
    goal = (raw.get("/robot1/navigation_command") or [b""])[0][8:].rstrip(b"\0").decode()
    check("the goal has its place", '"action":"goal"' in goal and "0.3" in goal, goal)
    first, second = replayed_twice(program, path)
    check("two replays of a live recording give the same maps", first == second and len(first) == 64, first)

    summary, why = replay_foreign(program, folder, "--scan-topic", SCAN_TOPIC, "--odom-topic", ODOMETRY_TOPIC)
    check("a bag of rosbags with names of its own is replayed", summary is not None, why)
    if summary:
        check("with every scan, in one piece", summary["scans"] == int(LENGTH_S * RATE_HZ) and not summary["unplaced_nodes"])
        width, height = known_area(folder / "elsewhere_map.yaml")
        longer, shorter = max(width, height), min(width, height)
        check("its map has the room's size", abs(longer - 8.0) < 0.5 and abs(shorter - 6.0) < 0.5, f"{longer:.2f} x {shorter:.2f} m")
    again, why = replay_foreign(program, folder)
    check("so it is without naming topics, where there is one of each kind", again is not None, why)
