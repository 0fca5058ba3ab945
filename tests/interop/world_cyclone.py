"""Robot 2 of a fleet whose world is ROS, by CycloneDDS: `world_cyclone.py RUN_DIR BINARY`

It stands in a square room and turns slowly; it publishes scans, best effort, and where it is as transforms on /tf, as
robots do that have no odometry topic. It publishes the state of its battery in percent, as a TurtleBot3 does.
"""

import math
import os
import sys
import time

from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

from idl import (BEST_EFFORT, LATCHED, RELIABLE, BatteryState, Header, LaserScan, OccupancyGrid, Quaternion, TFMessage, Time,
                 TransformStamped, Twist, Vector3)
from report import battery, row

BEAMS, HALF_M, TURN_RAD_S = 180, 1.5, 0.2


def distance(angle):
    """To the wall of a square room, from its middle."""
    return HALF_M / max(abs(math.cos(angle)), abs(math.sin(angle)))


def main():
    participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
    topic = lambda name, kind: Topic(participant, "rt" + name, kind)
    scans = DataWriter(participant, topic("/robot2/scan", LaserScan), qos=BEST_EFFORT)
    transforms = DataWriter(participant, topic("/tf", TFMessage), qos=RELIABLE)
    batteries = DataWriter(participant, topic("/robot2/battery_state", BatteryState), qos=RELIABLE)
    driver = DataWriter(participant, topic("/cmd_vel_2", Twist), qos=RELIABLE)
    maps = DataReader(participant, topic("/robot2/map", OccupancyGrid), qos=LATCHED)
    commands = DataReader(participant, topic("/robot2/cmd_vel", Twist), qos=RELIABLE)
    corrections = DataReader(participant, topic("/tf", TFMessage), qos=RELIABLE)
    grid, turns, told = None, [], set()
    begun, step = time.monotonic(), 0
    while (now := time.monotonic() - begun) < 12:
        yaw = TURN_RAD_S * now
        sec, nanosec = divmod(time.time_ns(), 10**9)
        turn = Quaternion(0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
        edge = TransformStamped(Header(Time(sec, nanosec), "odom_2"), "base_footprint_2", Vector3(0.0, 0.0, 0.0), turn)
        # SLAM's own transform is not for a robot to publish: it is left out, and the other taken.
        wrong = TransformStamped(Header(Time(sec, nanosec), "map_2"), "odom_2", Vector3(9.0, 9.0, 0.0), turn)
        transforms.write(TFMessage([wrong, edge]))
        if step % 2 == 0:
            ranges = [distance(yaw - math.pi + i * 2 * math.pi / BEAMS) for i in range(BEAMS)]
            scans.write(LaserScan(Header(Time(sec, nanosec), "base_scan_2"), -math.pi, math.pi, 2 * math.pi / BEAMS,
                                  0.0, 0.1, 0.12, 3.5, ranges, []))
        batteries.write(BatteryState(Header(Time(sec, nanosec), ""), 10.64, 0.0, 0.0, 0.0, 0.0, 1.8, 8.0, 0, 0, 0, True, [], [],
                                     "", ""))
        driver.write(Twist(Vector3(0.0, 0.0, 0.0), Vector3(0.0, 0.0, 0.4)))
        for sample in maps.take(N=10):
            grid = sample if isinstance(sample, OccupancyGrid) else grid
        turns += [c.angular.z for c in commands.take(N=100) if isinstance(c, Twist)]
        for sample in corrections.take(N=100):
            if isinstance(sample, TFMessage):
                told |= {(t.header.frame_id, t.child_frame_id, t.translation.x < 5.0) for t in sample.transforms}
        step += 1
        time.sleep(max(0.0, begun + 0.05 * step - time.monotonic()))
    known = sum(cell >= 0 for cell in grid.data) * grid.info.resolution**2 if grid else 0.0
    row("world = ros, by Cyclone's /tf: /robot2/map of a 3 x 3 m room", "7 to 12 m2 known", f"{known:.1f} m2",
        7 <= known <= 12)
    row("world = ros: a command reaches Cyclone's robot", "0.4 rad/s", turns[-3:],
        turns and all(abs(turn - 0.4) < 1e-6 for turn in turns[-3:]))
    known = battery(sys.argv[2], sys.argv[1], 1)
    row("world = ros: the state of Cyclone's battery, in percent", "0.08, critical", known,
        known and (known["charge"], known["level"], known["is_charging"]) == (0.08, "critical", None))
    row("world = ros: SLAM says map_2 -> odom_2", "it does", ("map_2", "odom_2", True) in told,
        ("map_2", "odom_2", True) in told)


main()
