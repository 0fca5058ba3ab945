"""A robot whose driver is started again, by CycloneDDS, in front of a fleet whose world is ROS: `driver_cyclone.py RUN BINARY`

It drives in a room. While it stands, its odometry begins anew: once below the same publisher, as when its microcontroller is reset, and
once with a new participant, as when its driver is started again. SLAM's pose must go on from where the robot stands.
"""

import json
import math
import os
import subprocess
import sys
import time

from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic

from idl import (BEST_EFFORT, RELIABLE, Header, LaserScan, Quaternion, TFMessage, Time, TransformStamped, Vector3)
from report import row

BEAMS, RANGE_MAX_M, PERIOD_S = 180, 8.0, 0.05
# Walls of a room without symmetry and of a box in it: ends, metres. The robot begins at the origin.
CORNERS = [(-1.5, -1.2), (3.6, -1.2), (3.6, 1.9), (1.4, 1.9), (1.4, 2.8), (-1.5, 2.8)]
BOX = [(1.7, 0.6), (2.2, 0.6), (2.2, 1.1), (1.7, 1.1)]
WALLS = [(ring[i - 1], ring[i]) for ring in (CORNERS, BOX) for i in range(len(ring))]
# What the robot does: seconds, m/s, rad/s, and what its driver does at the end.
PLAN = [(1.0, 0.0, 0.0, None), (5.0, 0.2, 0.0, None), (3.0, 0.0, 0.0, "reset"), (4.0, 0.0, 0.3, None),
        (4.0, 0.2, 0.0, None), (2.0, 0.0, 0.0, "restart"), (3.0, 0.15, -0.3, None), (3.0, 0.0, 0.0, None)]
# For how long the robot has no driver, and how long the fleet may take to start, seconds.
AWAY_S = 4.0
START_MAX_S = 60.0
NEAR_M, NEAR_RAD = 0.12, 0.08


def distance(x, y, angle):
    """To the nearest wall in a direction."""
    dx, dy, nearest = math.cos(angle), math.sin(angle), math.inf
    for (ax, ay), (bx, by) in WALLS:
        ex, ey = bx - ax, by - ay
        across = dx * ey - dy * ex
        if abs(across) < 1e-9:
            continue
        along = ((ax - x) * ey - (ay - y) * ex) / across
        share = ((ax - x) * dy - (ay - y) * dx) / across
        if along > 0.0 and 0.0 <= share <= 1.0:
            nearest = min(nearest, along)
    return nearest if nearest <= RANGE_MAX_M else math.inf


def after(pose, v, w, seconds):
    """Pose of a differential drive after a time at these velocities."""
    x, y, yaw = pose
    middle = yaw + w * seconds / 2
    return x + v * seconds * math.cos(middle), y + v * seconds * math.sin(middle), yaw + w * seconds


class Driver:
    """The robot's driver: what it publishes, with odometry from where it began."""

    def __init__(self):
        participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
        topic = lambda name, kind: Topic(participant, "rt" + name, kind)
        self.scans = DataWriter(participant, topic("/robot1/scan", LaserScan), qos=BEST_EFFORT)
        self.transforms = DataWriter(participant, topic("/tf", TFMessage), qos=RELIABLE)
        self.odom = (0.0, 0.0, 0.0)

    def publish(self, truth, has_scan):
        sec, nanosec = divmod(time.time_ns(), 10**9)
        x, y, yaw = self.odom
        turn = Quaternion(0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
        edge = TransformStamped(Header(Time(sec, nanosec), "robot1/odom"), "robot1/base_footprint", Vector3(x, y, 0.0), turn)
        self.transforms.write(TFMessage([edge]))
        if has_scan:
            ranges = [distance(truth[0], truth[1], truth[2] - math.pi + i * 2 * math.pi / BEAMS) for i in range(BEAMS)]
            self.scans.write(LaserScan(Header(Time(sec, nanosec), "robot1/base_scan"), -math.pi, math.pi,
                                       2 * math.pi / BEAMS, 0.0, 0.1, 0.12, RANGE_MAX_M, ranges, []))


def drive(driver, truth, seconds, v, w):
    """Drives for a time; returns the true pose."""
    begun = time.monotonic()
    for step in range(round(seconds / PERIOD_S)):
        truth, driver.odom = after(truth, v, w, PERIOD_S), after(driver.odom, v, w, PERIOD_S)
        driver.publish(truth, step % 2 == 0)
        time.sleep(max(0.0, begun + PERIOD_S * (step + 1) - time.monotonic()))
    return truth


def status(run, binary):
    """The robot's figures; none while the fleet starts."""
    said = subprocess.run([binary, "status", "--json", "--run-dir", run], capture_output=True, text=True, timeout=20)
    return json.loads(said.stdout)["robots"][0] if said.stdout else {"scans": 0}


def check(what, truth, run, binary):
    """Compares SLAM's pose with the truth: both count from where the robot began."""
    robot = status(run, binary)
    pose = robot["pose"] or (math.nan,) * 3
    away_m = math.hypot(pose[0] - truth[0], pose[1] - truth[1])
    turned_rad = abs(math.remainder(pose[2] - truth[2], 2 * math.pi))
    row(f"world = ros: the pose after {what}", f"tracking, within {NEAR_M} m and {NEAR_RAD} rad",
        f"{robot['state']}, {away_m:.3f} m, {turned_rad:.3f} rad",
        robot["state"] == "tracking" and away_m < NEAR_M and turned_rad < NEAR_RAD)


def main(run, binary):
    driver, truth, before = Driver(), (0.0, 0.0, 0.0), "a drive"
    # SLAM's map begins where the robot stands at its first scan.
    begun = time.monotonic()
    while status(run, binary)["scans"] < 5 and time.monotonic() < begun + START_MAX_S:
        drive(driver, truth, 0.5, 0.0, 0.0)
    for seconds, v, w, then in PLAN:
        truth = drive(driver, truth, seconds, v, w)
        if then:
            check(before, truth, run, binary)
        if then == "reset":
            driver.odom, before = (0.0, 0.0, 0.0), "odometry lost its origin below one publisher"
        elif then == "restart":
            del driver
            time.sleep(AWAY_S)
            driver, before = Driver(), "the driver was started again"
    check(before, truth, run, binary)


main(*sys.argv[1:])
