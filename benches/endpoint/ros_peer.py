"""The ROS 2 side of the comparison of endpoints: an rclpy node that publishes a fleet's mix and receives commands.

usage: ros_peer.py SECONDS
Prints `ready` when its node stands, waits for a line on stdin, publishes for SECONDS, and prints one line of JSON:
the number of messages sent on each topic, and the delay of each command received, in nanoseconds of CLOCK_MONOTONIC.
Stamps are CLOCK_MONOTONIC, taken just before `publish`; `frame_id` is the message's number on its topic.
"""

import json
import sys
import threading
import time

import rclpy
from geometry_msgs.msg import TransformStamped, TwistStamped
from nav_msgs.msg import OccupancyGrid
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import LaserScan

ROBOTS = 3
BEAMS = 180
MAP_CELLS = 384
PERIODS_S = {"transform": 0.05, "scan": 0.1, "map": 1.0}


def set_stamp(header, number):
    """Stamps a header with the time of now and with the message's number."""
    now = time.monotonic_ns()
    header.stamp.sec, header.stamp.nanosec = divmod(now, 1_000_000_000)
    header.frame_id = str(number)


def publications(node):
    """Returns (topic, period, publisher, message) for each topic."""
    scan = LaserScan(ranges=[2.0] * BEAMS, angle_increment=6.283 / BEAMS, range_max=3.5)
    grid = OccupancyGrid(data=[0] * MAP_CELLS ** 2)
    grid.info.width = grid.info.height = MAP_CELLS
    kinds = {"transform": (TransformStamped, TransformStamped()), "scan": (LaserScan, scan),
             "map": (OccupancyGrid, grid)}
    for robot in range(1, ROBOTS + 1):
        for kind, (message_type, message) in kinds.items():
            topic = f"/compared/robot{robot}/{kind}"
            yield topic, PERIODS_S[kind], node.create_publisher(message_type, topic, 10), message


def main():
    seconds = float(sys.argv[1])
    rclpy.init()
    node = rclpy.create_node("compared_peer")
    delays = []

    def receive(command):
        stamp = command.header.stamp
        delays.append(time.monotonic_ns() - (stamp.sec * 1_000_000_000 + stamp.nanosec))

    node.create_subscription(TwistStamped, "/compared/command", receive, 10)
    topics = list(publications(node))
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    threading.Thread(target=executor.spin, daemon=True).start()
    print("ready", flush=True)
    sys.stdin.readline()

    begun = time.monotonic()
    # The topics' first messages are spread over their periods, so that they do not come as one burst.
    due = [begun + period * index / len(topics) for index, (_, period, _, _) in enumerate(topics)]
    sent = [0] * len(topics)
    while True:
        index = min(range(len(topics)), key=due.__getitem__)
        if due[index] > begun + seconds:
            break
        time.sleep(max(0.0, due[index] - time.monotonic()))
        _, period, publisher, message = topics[index]
        set_stamp(message.header, sent[index])
        publisher.publish(message)
        sent[index] += 1
        due[index] += period
    # What is on its way arrives before the node ends.
    sys.stdin.readline()
    counts = {topic: count for (topic, _, _, _), count in zip(topics, sent)}
    print(json.dumps({"sent": counts, "command_delays_ns": delays}), flush=True)


main()
