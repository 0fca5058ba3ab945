"""Nav2's actions on a running fleet: goals, feedback and results by CycloneDDS as ROS 2 uses it (nav2_msgs is not on PyPI),
cancellation and status by rclpy on Fast DDS, and a goal from a ros_tcp client. `actions.py PORT`"""

import json
import os
import sys
import time
from dataclasses import dataclass

import rclpy
from action_msgs.msg import GoalStatusArray
from action_msgs.srv import CancelGoal
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float32, int8, int16, int32, int64, sequence, uint8, uint16, uint32, uint64
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from geometry_msgs.msg import PoseStamped as RosPoseStamped
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import deserialize_message
from std_msgs.msg import String

from idl import RELIABLE, Header, Pose, Quaternion, Time, Vector3, take
from report import row
from ros_tcp import Client

ROBOT = "robot1"
FRAME = "base_footprint_1"
GUID = 4711
EXECUTING, SUCCEEDED, CANCELED, ABORTED = 2, 4, 5, 6
# The fleet has just started, and robots drive 0.22 m/s at most.
DRIVE_S = 40


@dataclass
class Duration(IdlStruct, typename="builtin_interfaces::msg::dds_::Duration_"):
    sec: int32
    nanosec: uint32


@dataclass
class PoseStamped(IdlStruct, typename="geometry_msgs::msg::dds_::PoseStamped_"):
    header: Header
    pose: Pose


@dataclass
class MissedWaypoint(IdlStruct, typename="nav2_msgs::msg::dds_::MissedWaypoint_"):
    index: uint32
    goal: PoseStamped
    error_code: uint16
    error_msg: str


@dataclass
class PoseGoal(IdlStruct, typename="nav2_msgs::action::dds_::NavigateToPose_SendGoal_Request_"):
    guid: uint64
    sequence: int64
    goal_id: array[uint8, 16]
    pose: PoseStamped
    behavior_tree: str


@dataclass
class WaypointsGoal(IdlStruct, typename="nav2_msgs::action::dds_::FollowWaypoints_SendGoal_Request_"):
    guid: uint64
    sequence: int64
    goal_id: array[uint8, 16]
    number_of_loops: uint32
    goal_index: uint32
    poses: sequence[PoseStamped]


@dataclass
class PoseAccepted(IdlStruct, typename="nav2_msgs::action::dds_::NavigateToPose_SendGoal_Response_"):
    guid: uint64
    sequence: int64
    accepted: bool
    stamp: Time


@dataclass
class WaypointsAccepted(IdlStruct, typename="nav2_msgs::action::dds_::FollowWaypoints_SendGoal_Response_"):
    guid: uint64
    sequence: int64
    accepted: bool
    stamp: Time


@dataclass
class PoseAsked(IdlStruct, typename="nav2_msgs::action::dds_::NavigateToPose_GetResult_Request_"):
    guid: uint64
    sequence: int64
    goal_id: array[uint8, 16]


@dataclass
class WaypointsAsked(IdlStruct, typename="nav2_msgs::action::dds_::FollowWaypoints_GetResult_Request_"):
    guid: uint64
    sequence: int64
    goal_id: array[uint8, 16]


@dataclass
class PoseResult(IdlStruct, typename="nav2_msgs::action::dds_::NavigateToPose_GetResult_Response_"):
    guid: uint64
    sequence: int64
    status: int8
    error_code: uint16
    error_msg: str


@dataclass
class WaypointsResult(IdlStruct, typename="nav2_msgs::action::dds_::FollowWaypoints_GetResult_Response_"):
    guid: uint64
    sequence: int64
    status: int8
    missed_waypoints: sequence[MissedWaypoint]
    error_code: uint16
    error_msg: str


@dataclass
class PoseFeedback(IdlStruct, typename="nav2_msgs::action::dds_::NavigateToPose_FeedbackMessage_"):
    goal_id: array[uint8, 16]
    current_pose: PoseStamped
    navigation_time: Duration
    estimated_time_remaining: Duration
    number_of_recoveries: int16
    distance_remaining: float32


@dataclass
class WaypointsFeedback(IdlStruct, typename="nav2_msgs::action::dds_::FollowWaypoints_FeedbackMessage_"):
    goal_id: array[uint8, 16]
    current_waypoint: uint32


class Service:
    """A service's client on Cyclone."""

    def __init__(self, participant, name, request, response):
        self.replies = DataReader(participant, Topic(participant, f"rr{name}Reply", response), qos=RELIABLE)
        self.requests = DataWriter(participant, Topic(participant, f"rq{name}Request", request), qos=RELIABLE)
        self.request, self.sequence, self.answers = request, 0, {}

    def send(self, *fields):
        self.sequence += 1
        self.requests.write(self.request(GUID, self.sequence, *fields))
        return self.sequence

    def answer(self, number, seconds):
        """The response to a request, or none."""
        until = time.monotonic() + seconds
        while number not in self.answers and time.monotonic() < until:
            self.answers |= {a.sequence: a for a in take(self.replies, 0.05) if a.guid == GUID}
        return self.answers.get(number)


class Action:
    """An action's client on Cyclone."""

    def __init__(self, participant, name, kinds):
        goal, accepted, asked, result, feedback = kinds
        base = f"/{ROBOT}/{name}/_action"
        self.send_goal = Service(participant, f"{base}/send_goal", goal, accepted)
        self.get_result = Service(participant, f"{base}/get_result", asked, result)
        topic = Topic(participant, f"rt{base}/feedback", feedback)
        self.feedback = DataReader(participant, topic, qos=RELIABLE)

    def offer(self, number, *fields):
        """Whether the goal of this number was accepted; none without an answer."""
        request = self.send_goal.send([number] * 16, *fields)
        answer = self.send_goal.answer(request, 5)
        return answer and answer.accepted

    def ask(self, number):
        return self.get_result.send([number] * 16)


def pose(x):
    return PoseStamped(Header(Time(0, 0), FRAME), Pose(Vector3(x, 0.0, 0.0), Quaternion(0.0, 0.0, 0.0, 1.0)))


class Ros:
    """What rclpy knows of the action: its status, and its cancellation."""

    def __init__(self):
        rclpy.init()
        self.node = rclpy.create_node("interop_actions")
        self.statuses = set()
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        base = f"/{ROBOT}/navigate_to_pose/_action"
        self.node.create_subscription(GoalStatusArray, f"{base}/status", self.on_status, latched)
        self.client = self.node.create_client(CancelGoal, f"{base}/cancel_goal")

    def on_status(self, message):
        self.statuses |= {(goal.goal_info.goal_id.uuid[0], goal.status) for goal in message.status_list}

    def wait_for(self, status, seconds=5):
        until = time.monotonic() + seconds
        while status not in self.statuses and time.monotonic() < until:
            rclpy.spin_once(self.node, timeout_sec=0.05)
        return status in self.statuses

    def cancel(self, number):
        if not self.client.wait_for_service(timeout_sec=10):
            return None
        request = CancelGoal.Request()
        request.goal_info.goal_id.uuid = [number] * 16
        future = self.client.call_async(request)
        rclpy.spin_until_future_complete(self.node, future, timeout_sec=10)
        return future.result()


def navigate(action, ros):
    """A goal that is reached."""
    accepted = None
    for number in range(1, 9):
        # The first requests may come before both sides know of each other.
        accepted = action.offer(number, pose(0.3), "")
        if accepted is not None:
            break
    row("navigate_to_pose is accepted (Cyclone)", True, accepted, accepted)
    asked = action.ask(number)
    row("its status on rclpy", "executing", sorted(ros.statuses), ros.wait_for((number, EXECUTING)))
    result = action.get_result.answer(asked, DRIVE_S)
    row("its result, at the end", SUCCEEDED, result and (result.status, result.error_msg),
        result is not None and result.status == SUCCEEDED)
    feedback = [f for f in take(action.feedback, 0.5) if f.goal_id[0] == number]
    poses = [round(f.current_pose.pose.position.x, 2) for f in feedback]
    row("its feedback", "poses on the way, in a map", (len(poses), poses[:1], poses[-1:]),
        len(poses) >= 2 and all(f.current_pose.header.frame_id in ("map", f"map_{ROBOT[-1]}") for f in feedback))
    row("its last status on rclpy", "succeeded", sorted(ros.statuses), ros.wait_for((number, SUCCEEDED)))


def refuse_cancel_replace(action, ros):
    """Goals that do not get to their end."""
    unknown = action.get_result.answer(action.ask(99), 5)
    row("the result of an unknown goal", 0, unknown and unknown.status, unknown and unknown.status == 0)
    accepted = action.offer(20, pose(0.3), "my_tree.xml")
    row("a goal with a behaviour tree", "refused", accepted, accepted is False)
    action.offer(21, pose(-0.3), "")
    asked = action.ask(21)
    answer = ros.cancel(21)
    row("rclpy cancels it", "1 goal", answer and (answer.return_code, len(answer.goals_canceling)),
        answer and answer.return_code == 0 and len(answer.goals_canceling) == 1)
    result = action.get_result.answer(asked, 10)
    row("the cancelled goal's result", CANCELED, result and result.status, result and result.status == CANCELED)
    action.offer(22, pose(-0.3), "")
    asked = action.ask(22)
    action.offer(23, pose(0.0), "")
    result = action.get_result.answer(asked, 10)
    row("a replaced goal's result", ABORTED, result and (result.status, result.error_msg),
        result and result.status == ABORTED)


def follow(action):
    """Waypoints that are all reached."""
    accepted = None
    for number in range(31, 39):
        accepted = action.offer(number, 0, 0, [pose(-0.2), pose(0.0)])
        if accepted is not None:
            break
    result = action.get_result.answer(action.ask(number), DRIVE_S)
    row("follow_waypoints", SUCCEEDED, result and (result.status, len(result.missed_waypoints), result.error_msg),
        result and result.status == SUCCEEDED and not result.missed_waypoints)
    waypoints = {f.current_waypoint for f in take(action.feedback, 0.5) if f.goal_id[0] == number}
    row("its feedback", {0, 1}, waypoints, waypoints == {0, 1})


def goal_on_tcp(port):
    """A goal from a ros_tcp client."""
    client = Client(port)
    state = f"/{ROBOT}/navigation_state"
    client.subscribe(state, "std_msgs/String")
    client.advertise(f"/{ROBOT}/goal_pose", "geometry_msgs/PoseStamped")
    message = RosPoseStamped()
    message.header.frame_id = FRAME
    message.pose.position.x, message.pose.orientation.w = 0.2, 1.0
    client.publish(f"/{ROBOT}/goal_pose", message)
    states, until = [], time.monotonic() + DRIVE_S
    while time.monotonic() < until and not ("driving" in states and states[-1] == "reached"):
        time.sleep(0.1)
        payloads = list(client.messages.get(state, []))
        states = [json.loads(deserialize_message(payload, String).data)["state"] for payload in payloads]
        states = states[max((i for i, s in enumerate(states) if s == "planning"), default=0):]
    row("a goal on /robot1/goal_pose from TCP", "driving, then reached", states[-3:],
        "driving" in states and states[-1] == "reached")
    client.close()


def main(port):
    participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
    ros = Ros()
    to_pose = Action(participant, "navigate_to_pose", (PoseGoal, PoseAccepted, PoseAsked, PoseResult, PoseFeedback))
    waypoints = Action(participant, "follow_waypoints",
                       (WaypointsGoal, WaypointsAccepted, WaypointsAsked, WaypointsResult, WaypointsFeedback))
    navigate(to_pose, ros)
    refuse_cancel_replace(to_pose, ros)
    follow(waypoints)
    goal_on_tcp(port)
    ros.node.destroy_node()
    rclpy.shutdown()


main(int(sys.argv[1]))
