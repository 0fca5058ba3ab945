"""A robot of ROS's own in front of a fleet whose world is ROS: `world_rclpy.py PORT RUN_DIR BINARY`

It stands in a square room, turns slowly, publishes scans and odometry with frames that bear no number, the state of its
battery as a share, and hears its commands.
"""

import math
import sys
import time

import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import BatteryState, LaserScan

from report import battery, row

BEAMS, HALF_M, TURN_RAD_S = 180, 2.0, 0.2


def distance(angle):
    """To the wall of a square room, from its middle."""
    return HALF_M / max(abs(math.cos(angle)), abs(math.sin(angle)))


def main():
    rclpy.init()
    node = rclpy.create_node("robot1")
    scans = node.create_publisher(LaserScan, "/robot1/scan", qos_profile_sensor_data)
    odometry = node.create_publisher(Odometry, "/robot1/odom", 10)
    batteries = node.create_publisher(BatteryState, "/robot1/battery_state", 10)
    maps, poses, heard = [], [], []
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    node.create_subscription(OccupancyGrid, "/robot1/map", maps.append, latched)
    node.create_subscription(Twist, "/robot1/cmd_vel", heard.append, 10)
    driver = node.create_publisher(Twist, "/cmd_vel_1", 10)
    begun = time.monotonic()
    step = 0
    while (now := time.monotonic() - begun) < 12:
        yaw = TURN_RAD_S * now
        stamp = node.get_clock().now().to_msg()
        odom = Odometry()
        odom.header.stamp, odom.header.frame_id, odom.child_frame_id = stamp, "odom", "base_footprint"
        odom.pose.pose.orientation.z, odom.pose.pose.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
        odometry.publish(odom)
        if step % 2 == 0:
            scan = LaserScan(angle_min=-math.pi, angle_max=math.pi, angle_increment=2 * math.pi / BEAMS)
            scan.header.stamp, scan.header.frame_id = stamp, "base_scan"
            scan.range_min, scan.range_max, scan.scan_time = 0.12, 3.5, 0.1
            scan.ranges = [distance(yaw - math.pi + i * 2 * math.pi / BEAMS) for i in range(BEAMS)]
            scans.publish(scan)
            # What is wild must change nothing.
            scans.publish(LaserScan(angle_increment=math.nan, ranges=[math.inf, -1.0]))
        batteries.publish(BatteryState(percentage=0.42, voltage=11.26, present=True, power_supply_status=2))
        message = Twist()
        message.angular.z = 0.3
        driver.publish(message)
        step += 1
        until = begun + 0.05 * step
        while time.monotonic() < until:
            rclpy.spin_once(node, timeout_sec=max(0.0, until - time.monotonic()))
    grid = maps[-1] if maps else None
    known = sum(cell >= 0 for cell in grid.data) * grid.info.resolution**2 if grid else 0.0
    row("world = ros: /robot1/map of a 4 x 4 m room", "12 to 20 m2 known", f"{known:.1f} m2", 12 <= known <= 20)
    age = time.time() - (grid.header.stamp.sec if grid else 0)
    row("world = ros: stamps are real time", "< 15 s old", f"{age:.0f} s", age < 15)
    turn = [m.angular.z for m in heard[-5:]]
    row("world = ros: a command reaches the robot", "0.3 rad/s", turn, turn and all(abs(t - 0.3) < 1e-6 for t in turn))
    known = battery(sys.argv[3], sys.argv[2], 0)
    row("world = ros: the state of a battery, as a share", "0.42, 11.26 V, not charging", known,
        known and (known["charge"], known["voltage_v"], known["is_charging"]) == (0.42, 11.26, False))
    publishers = {i.node_name for i in node.get_publishers_info_by_topic("/robot1/scan")}
    row("world = ros: the fleet does not publish the robot's own topics", "{'robot1'}", publishers,
        publishers == {"robot1"})
    node.destroy_node()
    rclpy.shutdown()


main()
