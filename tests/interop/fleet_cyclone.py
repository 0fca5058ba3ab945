"""A running fleet of two robots as CycloneDDS sees it."""

import os
import time
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float32, float64, int8, int32, sequence, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from report import row


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs::msg::dds_::Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Pose(IdlStruct, typename="geometry_msgs::msg::dds_::Pose_"):
    position: Vector3
    orientation: Quaternion


@dataclass
class TransformStamped(IdlStruct, typename="geometry_msgs::msg::dds_::TransformStamped_"):
    header: Header
    child_frame_id: str
    translation: Vector3
    rotation: Quaternion


@dataclass
class TFMessage(IdlStruct, typename="tf2_msgs::msg::dds_::TFMessage_"):
    transforms: sequence[TransformStamped]


@dataclass
class LaserScan(IdlStruct, typename="sensor_msgs::msg::dds_::LaserScan_"):
    header: Header
    angle_min: float32
    angle_max: float32
    angle_increment: float32
    time_increment: float32
    scan_time: float32
    range_min: float32
    range_max: float32
    ranges: sequence[float32]
    intensities: sequence[float32]


@dataclass
class MapMetaData(IdlStruct, typename="nav_msgs::msg::dds_::MapMetaData_"):
    map_load_time: Time
    resolution: float32
    width: uint32
    height: uint32
    origin: Pose


@dataclass
class OccupancyGrid(IdlStruct, typename="nav_msgs::msg::dds_::OccupancyGrid_"):
    header: Header
    info: MapMetaData
    data: sequence[int8]


@dataclass
class Twist(IdlStruct, typename="geometry_msgs::msg::dds_::Twist_"):
    linear: Vector3
    angular: Vector3


@dataclass
class PoseWithCovariance(IdlStruct, typename="geometry_msgs::msg::dds_::PoseWithCovariance_"):
    pose: Pose
    covariance: array[float64, 36]


@dataclass
class TwistWithCovariance(IdlStruct, typename="geometry_msgs::msg::dds_::TwistWithCovariance_"):
    twist: Twist
    covariance: array[float64, 36]


@dataclass
class Odometry(IdlStruct, typename="nav_msgs::msg::dds_::Odometry_"):
    header: Header
    child_frame_id: str
    pose: PoseWithCovariance
    twist: TwistWithCovariance


RELIABLE = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(100))
BEST_EFFORT = Qos(Policy.Reliability.BestEffort, Policy.History.KeepLast(100))
LATCHED = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.Durability.TransientLocal,
              Policy.History.KeepLast(10))


def take(reader, seconds, enough=10**9):
    """What came within so many seconds."""
    samples, until = [], time.monotonic() + seconds
    while time.monotonic() < until and len(samples) < enough:
        samples += [s for s in reader.take(N=100) if hasattr(s, "__dataclass_fields__")]
        time.sleep(0.005)
    return samples


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
    # Each robot: its links at 20 Hz, map -> odom at 10 Hz; the anchors at about 1 Hz.
    moving = rate(participant, "/tf", TFMessage, 61)
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


main()
