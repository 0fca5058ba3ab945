"""A running fleet of two robots as CycloneDDS sees it."""

import os

from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from idl import BEST_EFFORT, LATCHED, RELIABLE, Bool, Empty, LaserScan, OccupancyGrid, Odometry, TFMessage, Twist, Vector3, take
from report import row


def rate(participant, name, kind, hz, qos=RELIABLE, label="reliable"):
    reader = DataReader(participant, Topic(participant, "rt" + name, kind), qos=qos)
    take(reader, 5, enough=1)
    samples = take(reader, 4)
    measured = len(samples) / 4
    row(f"Cyclone: {name}, {label}", f"{hz:g} Hz", f"{measured:.2f} Hz", abs(measured - hz) <= 0.1 * hz)
    return samples


def main():
    participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
    rate(participant, "/robot1/scan", LaserScan, 10)
    scans = rate(participant, "/robot2/scan", LaserScan, 10, BEST_EFFORT, "best effort")
    row("Cyclone: LaserScan's content", "180 beams, base_scan_2", f"{len(scans[-1].ranges)} beams",
        len(scans[-1].ranges) == 180 and scans[-1].header.frame_id == "base_scan_2")
    # Each robot: its links at 20 Hz, map -> odom at 10 Hz; the map_transforms at about 1 Hz.
    # The robots' own edges at 20 Hz, merging's corrections, and the chain of map repeated at 50 Hz (transform_rate_hz).
    moving = rate(participant, "/tf", TFMessage, 111)
    edges = {(t.header.frame_id, t.child_frame_id) for m in moving for t in m.transforms}
    wanted = {(f"odom_{k}", f"base_footprint_{k}") for k in (1, 2)} | {(f"map_{k}", f"odom_{k}") for k in (1, 2)}
    wanted |= {("map", "map_1"), ("map", "map_2")}
    row("Cyclone: /tf's moving edges", "odom, map of each robot", f"{len(edges)} edges", wanted <= edges)
    static = DataReader(participant, Topic(participant, "rt/tf_static", TFMessage), qos=LATCHED)
    fixed = {t.child_frame_id for m in take(static, 3, enough=1) for t in m.transforms}
    row("Cyclone: /tf_static to a late joiner", "6 fixed frames", sorted(fixed),
        {f"{f}_{k}" for f in ("base_link", "base_scan", "imu_link") for k in (1, 2)} == fixed)
    row("Cyclone: /tf has no fixed edges", "none", edges & {("base_link_1", "base_scan_1")},
        not fixed & {child for _, child in edges})
    for name in ("/robot1/map", "/merged_map"):
        reader = DataReader(participant, Topic(participant, "rt" + name, OccupancyGrid), qos=LATCHED)
        maps = take(reader, 5, enough=1)
        size = f"{maps[0].info.width} x {maps[0].info.height}" if maps else "none"
        row(f"Cyclone: {name} to a late joiner", "a map", size,
            maps and len(maps[0].data) == maps[0].info.width * maps[0].info.height)
    drive(participant)
    stop(participant)


def drive(participant):
    odom = DataReader(participant, Topic(participant, "rt/robot2/odom", Odometry), qos=RELIABLE)
    for qos, label in ((RELIABLE, "reliable"), (BEST_EFFORT, "best effort")):
        writer = DataWriter(participant, Topic(participant, "rt/robot2/cmd_vel", Twist), qos=qos)
        start = take(odom, 5, enough=3)[-1].pose.pose.orientation.z
        zero = Vector3(0.0, 0.0, 0.0)
        end = start
        for _ in range(40):
            writer.write(Twist(zero, Vector3(0.0, 0.0, 0.8)))
            for sample in take(odom, 0.05):
                end = sample.pose.pose.orientation.z
        writer.write(Twist(zero, zero))
        row(f"Cyclone: /robot2/cmd_vel turns, {label}", "> 0.1", f"{abs(end - start):.3f}", abs(end - start) > 0.1)


def stop(participant):
    """Sets and releases the emergency stop: its state is on the topic of the command."""
    states = DataReader(participant, Topic(participant, "rt/emergency_stop", Bool), qos=LATCHED)
    command = DataWriter(participant, Topic(participant, "rt/emergency_stop", Bool), qos=RELIABLE)
    release = DataWriter(participant, Topic(participant, "rt/emergency_stop_release", Empty), qos=RELIABLE)
    take(states, 3)
    seen = []
    for _ in range(5):
        command.write(Bool(True))
        seen += [state.data for state in take(states, 3, enough=1)]
        release.write(Empty(0))
        seen += [state.data for state in take(states, 3, enough=1)]
    row("Cyclone: changes of /emergency_stop", "5 of True, False", f"{len(seen)} changes", seen == [True, False] * 5)


main()
