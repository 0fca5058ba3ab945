"""A running fleet of two robots as ROS 2 with Fast DDS sees it. `fleet_rclpy.py RUN_DIR`"""

import os
import sys
import time

import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped, Twist, TwistStamped
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Bool, Empty, Float32MultiArray, Int32

from report import row

NODE = "mr_slam"
RELIABLE = QoSProfile(depth=10)
BEST_EFFORT = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
WATCH_S = 6.0

# topic, type, its name, rate in Hz
TOPICS = [
    ("/robot1/scan", LaserScan, 10.0),
    ("/robot2/scan", LaserScan, 10.0),
    ("/robot1/odom", Odometry, 20.0),
    ("/robot2/odom", Odometry, 20.0),
    ("/robot1/pose", PoseWithCovarianceStamped, 10.0),
    ("/robot2/pose", PoseWithCovarianceStamped, 10.0),
    ("/robot1/slam_stats", Float32MultiArray, 1.0),
    ("/robot2/slam_stats", Float32MultiArray, 1.0),
    ("/clock", Clock, 100.0),
]
MAPS = ["/robot1/map", "/robot2/map", "/merged_map", "/map"]
NAMED = {
    "/tf": "tf2_msgs/msg/TFMessage",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/map": "nav_msgs/msg/OccupancyGrid",
    "/merged_map": "nav_msgs/msg/OccupancyGrid",
    "/robot2/scan": "sensor_msgs/msg/LaserScan",
    "/cmd_vel_1": "geometry_msgs/msg/Twist",
    "/robot2/cmd_vel": "geometry_msgs/msg/Twist",
    "/robot2/cmd_vel_stamped": "geometry_msgs/msg/TwistStamped",
    "/emergency_stop": "std_msgs/msg/Bool",
    "/initialpose": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/robot2/initialpose": "geometry_msgs/msg/PoseWithCovarianceStamped",
}


def spin(node, seconds, until=lambda: False):
    """Lets messages come in; how long until `until` held."""
    begun = time.monotonic()
    while time.monotonic() - begun < seconds and not until():
        rclpy.spin_once(node, timeout_sec=0.02)
    return time.monotonic() - begun


class Listener:
    """Counts and keeps what comes on a topic."""

    def __init__(self, node, topic, kind, qos):
        self.count, self.newest, self.all = 0, None, []
        self.subscription = node.create_subscription(kind, topic, self.hear, qos)

    def hear(self, message):
        self.count += 1
        self.newest = message
        self.all = (self.all + [message])[-20:]


def names(node):
    spin(node, 20, lambda: NODE in node.get_node_names())
    row("node in the graph", NODE, NODE if NODE in node.get_node_names() else node.get_node_names(),
        NODE in node.get_node_names())
    took = spin(node, 5, lambda: all(t in dict(node.get_topic_names_and_types()) for t in NAMED))
    there = dict(node.get_topic_names_and_types())
    wrong = {t: there.get(t) for t, kind in NAMED.items() if there.get(t) != [kind]}
    row("topics and types in the graph", f"{len(NAMED)} as listed", wrong or f"all, {took:.2f} s", not wrong)
    owners = {i.node_name for t in ("/robot1/scan", "/map", "/tf") for i in node.get_publishers_info_by_topic(t)}
    row("publishers belong to the node", {NODE}, owners, owners == {NODE})
    owners = {i.node_name for i in node.get_subscriptions_info_by_topic("/cmd_vel_1")}
    row("subscriptions belong to the node", {NODE}, owners, owners == {NODE})


def streams(node):
    for label, qos in (("reliable", RELIABLE), ("best effort", BEST_EFFORT)):
        heard = {topic: Listener(node, topic, kind, qos) for topic, kind, _ in TOPICS}
        maps = {topic: Listener(node, topic, OccupancyGrid, LATCHED) for topic in MAPS} if qos is RELIABLE else {}
        spin(node, 5, lambda: all(h.count for h in heard.values()))
        before = {topic: h.count for topic, h in heard.items()}
        begun = time.monotonic()
        spin(node, WATCH_S)
        elapsed = time.monotonic() - begun
        for topic, _, hz in TOPICS:
            rate = (heard[topic].count - before[topic]) / elapsed
            row(f"{topic}, {label}", f"{hz:g} Hz", f"{rate:.2f} Hz", abs(rate - hz) <= max(0.1 * hz, 0.35))
        if maps:
            contents(heard, maps)
        for listener in [*heard.values(), *maps.values()]:
            node.destroy_subscription(listener.subscription)
        spin(node, 0.3)


def contents(heard, maps):
    scan = heard["/robot1/scan"].newest
    row("LaserScan's content", "180 beams, base_scan_1", f"{len(scan.ranges)} beams, {scan.header.frame_id}",
        len(scan.ranges) == 180 and scan.header.frame_id == "base_scan_1" and 3.4 < scan.range_max < 3.6)
    odom = heard["/robot2/odom"].newest
    row("Odometry's content", "odom_2 -> base_footprint_2", f"{odom.header.frame_id} -> {odom.child_frame_id}",
        (odom.header.frame_id, odom.child_frame_id) == ("odom_2", "base_footprint_2"))
    pose = heard["/robot1/pose"].newest
    row("pose's content", "map_1, covariance", f"{pose.header.frame_id}, {pose.pose.covariance[0]:.2g} m2",
        pose.header.frame_id == "map_1" and 0 < pose.pose.covariance[0] < 1)
    stats = heard["/robot1/slam_stats"].newest.data
    row("slam_stats' content", "7 values that add up", f"{len(stats)} values",
        len(stats) == 7 and sum(stats[:3]) == stats[3] == stats[4] * stats[5])
    for topic, listener in maps.items():
        grid = listener.newest
        size = f"{grid.info.width} x {grid.info.height}" if grid else "none"
        sound = grid and len(grid.data) == grid.info.width * grid.info.height
        values = set(grid.data) if grid else set()
        row(topic, "a map, -1 to 100", size, sound and -1 in values and max(values) > 65 and min(values) == -1)


def commands(node):
    chosen = node.create_publisher(Int32, "/selected_robot", 10)
    spin(node, 5, chosen.get_subscription_count)
    repeat(node, chosen, Int32(data=2))
    for topic, kind, robot in (
        ("/cmd_vel", Twist, 2),
        ("/cmd_vel_1", Twist, 1),
        ("/robot1/cmd_vel", Twist, 1),
        ("/robot2/cmd_vel_stamped", TwistStamped, 2),
        ("/cmd_vel_stamped", TwistStamped, 2),
    ):
        odom = Listener(node, f"/robot{robot}/odom", Odometry, RELIABLE)
        publisher = node.create_publisher(kind, topic, 10)
        spin(node, 5, lambda: odom.count and publisher.get_subscription_count())
        start = odom.newest.pose.pose.orientation.z
        for _ in range(30):
            turn(publisher, kind, 0.8)
            spin(node, 0.05)
        turned = abs(odom.newest.pose.pose.orientation.z - start)
        turn(publisher, kind, 0.0)
        row(f"{topic} turns robot {robot}", "> 0.1", f"{turned:.3f}", turned > 0.1)
        if topic == "/cmd_vel_1":
            stop(node, publisher, odom)
        node.destroy_publisher(publisher)
        node.destroy_subscription(odom.subscription)
        spin(node, 1.2)  # The lease of who drove before ends.


def turn(publisher, kind, rad_s):
    message = kind()
    (message.twist if kind is TwistStamped else message).angular.z = rad_s
    publisher.publish(message)


def repeat(node, publisher, message):
    """Says it for a while, then waits: one who has just been discovered may hear the first late."""
    for _ in range(15):
        publisher.publish(message)
        spin(node, 0.1)
    spin(node, 1.5)


def stop(node, publisher, odom):
    halt = node.create_publisher(Bool, "/emergency_stop", 10)
    release = node.create_publisher(Empty, "/emergency_stop_release", 10)
    spin(node, 5, lambda: halt.get_subscription_count() and release.get_subscription_count())
    repeat(node, halt, Bool(data=True))
    start = odom.newest.pose.pose.orientation.z
    for _ in range(10):
        turn(publisher, Twist, 0.8)
        spin(node, 0.05)
    turned = abs(odom.newest.pose.pose.orientation.z - start)
    row("/emergency_stop holds", "< 0.02", f"{turned:.3f}", turned < 0.02)
    repeat(node, release, Empty())
    for _ in range(10):
        turn(publisher, Twist, 0.8)
        spin(node, 0.05)
    turned = abs(odom.newest.pose.pose.orientation.z - start)
    row("/emergency_stop_release lets go", "> 0.05", f"{turned:.3f}", turned > 0.05)
    turn(publisher, Twist, 0.0)


def cpu_s(run_dir):
    """CPU seconds of the fleet's bridge so far."""
    import pathlib
    for stat in pathlib.Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = stat.read_bytes().split(b"\0")
            if words[1:3] == [b"worker", b"bridge"] and run_dir.encode() in words:
                fields = (stat.parent / "stat").read_text().rsplit(")", 1)[1].split()
                return (int(fields[11]) + int(fields[12])) / 100
        except (OSError, IndexError):
            continue
    return float("nan")


def load(node, run_dir):
    """CPU of the bridge with a subscriber of everything."""
    heard = [Listener(node, topic, kind, RELIABLE) for topic, kind, _ in TOPICS]
    heard += [Listener(node, topic, OccupancyGrid, LATCHED) for topic in MAPS]
    spin(node, 2)
    begun, cpu = time.monotonic(), cpu_s(run_dir)
    spin(node, 10)
    share = (cpu_s(run_dir) - cpu) / (time.monotonic() - begun)
    row("bridge's CPU with a subscriber of everything", "<= 8 % of a core", f"{100 * share:.1f} %", share <= 0.08)


def main(run_dir):
    rclpy.init()
    node = rclpy.create_node("interop")
    names(node)
    streams(node)
    commands(node)
    load(node, run_dir)
    # All is measured and printed. Fast DDS has hung in its own shutdown, for minutes: it is left to the operating system.
    sys.stdout.flush()
    os._exit(0)


main(sys.argv[1])
