"""SLAM's services and `/initialpose` from ROS 2, on a running fleet of two robots: the types that rclpy has. What the
services did is asked for at the command line. `services.py RUN_DIR BINARY`"""

import json
import math
import subprocess
import sys
import time

import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped
from std_srvs.srv import SetBool, Trigger

from report import row

POSE_HZ = 10.0
ASIDE_M = 0.6


def call(node, kind, name, request):
    """The response, or none."""
    client = node.create_client(kind, name)
    if not client.wait_for_service(timeout_sec=10):
        return None
    future = client.call_async(request)
    rclpy.spin_until_future_complete(node, future, timeout_sec=25)
    return future.result()


def state(binary, run_dir):
    """How robot2's SLAM stands."""
    command = [binary, "slam", "robot2", "state", "--json", "--run-dir", run_dir]
    return json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


class Poses:
    """Where SLAM says robot 2 is."""

    def __init__(self, node):
        self.node, self.all = node, []
        node.create_subscription(PoseWithCovarianceStamped, "/robot2/pose", self.all.append, 10)

    def within(self, seconds):
        """What came in so many seconds."""
        before, until = len(self.all), time.monotonic() + seconds
        while time.monotonic() < until:
            rclpy.spin_once(self.node, timeout_sec=0.02)
        return self.all[before:]


def place(node, poses):
    """A person puts the robot aside of where it is: SLAM must take it for there."""
    told = node.create_publisher(PoseWithCovarianceStamped, "/initialpose", 10)
    until = time.monotonic() + 5
    while time.monotonic() < until and not told.get_subscription_count():
        rclpy.spin_once(node, timeout_sec=0.02)
    known = poses.within(1.0)
    if not known:
        return row("/initialpose", "a pose to begin with", "none", False)
    message = PoseWithCovarianceStamped()
    message.header.frame_id = "map_2"
    message.pose.pose = known[-1].pose.pose
    x, y = message.pose.pose.position.x, message.pose.pose.position.y
    message.pose.pose.position.x += ASIDE_M
    for axis in (0, 7, 35):
        message.pose.covariance[axis] = 0.01
    told.publish(message)
    away = [math.hypot(p.pose.pose.position.x - x, p.pose.pose.position.y - y) for p in poses.within(3.0)]
    row("/initialpose moves where robot 2 is taken to be", f"about {ASIDE_M} m", f"{max(away, default=0):.2f} m",
        away and 0.5 * ASIDE_M < max(away) < 2 * ASIDE_M)


def main(run_dir, binary):
    rclpy.init()
    node = rclpy.create_node("interop_services")

    def ask(name, kind, request, expected):
        """`expected`: what must then be so."""
        answer = call(node, kind, f"/robot2/{name}", request)
        said = answer and (answer.success, answer.message)
        is_so = {key: state(binary, run_dir)[key] for key in expected}
        row(f"/robot2/{name}", f"success, {expected}", f"{said}, {is_so}", answer and answer.success and is_so == expected)

    poses = Poses(node)
    ask("pause", SetBool, SetBool.Request(data=True), {"paused": True})
    count = len(poses.within(2.0))
    row("/robot2/pose goes on, by the wheels", f"{2 * POSE_HZ:g}", count, abs(count - 2 * POSE_HZ) <= 5)
    ask("pause", SetBool, SetBool.Request(data=False), {"paused": False})
    ask("clear_closures", Trigger, Trigger.Request(), {"closures": 0})
    place(node, poses)
    # It stands: one look is not enough to be believed.
    ask("relocalize", Trigger, Trigger.Request(), {"located": False})
    ask("reset", Trigger, Trigger.Request(), {"mode": "mapping"})
    node.destroy_node()
    rclpy.shutdown()


main(*sys.argv[1:3])
