"""SLAM's services and `/initialpose` from ROS 2, on a running fleet of two robots: the types that rclpy has."""

import math
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


def said(what, answer):
    """A row for an answer that must say yes."""
    row(what, "done", answer and (answer.success, answer.message), answer and answer.success)


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
    here = known[-1].pose.pose.position
    message = PoseWithCovarianceStamped()
    message.header.frame_id = "map_2"
    message.pose.pose = known[-1].pose.pose
    x, y = here.x, here.y
    message.pose.pose.position.x += ASIDE_M
    for axis in (0, 7):
        message.pose.covariance[axis] = 0.01
    message.pose.covariance[35] = 0.01
    told.publish(message)
    away = [math.hypot(p.pose.pose.position.x - x, p.pose.pose.position.y - y) for p in poses.within(3.0)]
    row("/initialpose moves where robot 2 is taken to be", f"about {ASIDE_M} m", f"{max(away, default=0):.2f} m",
        away and 0.5 * ASIDE_M < max(away) < 2 * ASIDE_M)


def main():
    rclpy.init()
    node = rclpy.create_node("interop_services")
    poses = Poses(node)
    poses.within(2.0)
    said("/robot2/pause", call(node, SetBool, "/robot2/pause", SetBool.Request(data=True)))
    count = len(poses.within(2.0))
    row("/robot2/pose goes on, by the wheels", f"{2 * POSE_HZ:g}", count, abs(count - 2 * POSE_HZ) <= 5)
    said("/robot2/pause lets go", call(node, SetBool, "/robot2/pause", SetBool.Request(data=False)))
    said("/robot2/clear_closures", call(node, Trigger, "/robot2/clear_closures", Trigger.Request()))
    place(node, poses)
    said("/robot2/relocalize", call(node, Trigger, "/robot2/relocalize", Trigger.Request()))
    said("/robot2/reset", call(node, Trigger, "/robot2/reset", Trigger.Request()))
    node.destroy_node()
    rclpy.shutdown()


main()
