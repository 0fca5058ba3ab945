"""Topics and services between ROS 2 with Fast DDS and a ros_tcp client of a running fleet of two robots.
`tcp_rclpy.py PORT`"""

import struct
import sys
import time

import rclpy
from geometry_msgs.msg import PointStamped, PoseStamped
from nav_msgs.msg import OccupancyGrid, Path
from nav_msgs.srv import GetPlan
from rclpy.executors import SingleThreadedExecutor
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Image
from std_msgs.msg import Float32MultiArray, String
from std_srvs.srv import Empty, SetBool, Trigger

from report import row
from ros_tcp import Client

POSES = 300
# A longer response to rclpy is refused: see docs/limits.md.
FEW_POSES = 10
PIXELS = 640 * 480


def path(count):
    return Path(poses=[PoseStamped() for _ in range(count)])


# Type, its name, a message, and what makes it out.
TOPICS = [
    (String, "std_msgs/String", String(data="Grüße"), lambda m: m.data),
    (PoseStamped, "geometry_msgs/PoseStamped", PoseStamped(), lambda m: m.pose.orientation.w),
    (PointStamped, "geometry_msgs/PointStamped", PointStamped(), lambda m: m.point.x),
    (Path, "nav_msgs/Path", path(POSES), lambda m: len(m.poses)),
    (Float32MultiArray, "std_msgs/Float32MultiArray", Float32MultiArray(data=[1.0, 2.5]), lambda m: list(m.data)),
    (Image, "sensor_msgs/Image", Image(width=640, height=480, data=bytes([7]) * PIXELS), lambda m: len(m.data)),
]


class Ros:
    """A ROS node that is spun by hand."""

    def __init__(self):
        self.node = rclpy.create_node("interop_tcp")
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)

    def spin(self, seconds=0.01, until=lambda: False):
        end = time.monotonic() + seconds
        while not until() and time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.01)

    def call(self, kind, name, request, seconds=10):
        """The response, or none."""
        client = self.node.create_client(kind, name)
        self.spin(10, client.service_is_ready)
        future = client.call_async(request)
        self.spin(seconds, future.done)
        return future.result() if future.done() else None


def topics(ros, client):
    for number, (kind, type_name, message, essence) in enumerate(TOPICS):
        out, back = f"/interop/from_ros_{number}", f"/interop/from_tcp_{number}"
        publisher = ros.node.create_publisher(kind, out, 10)
        heard = []
        ros.node.create_subscription(kind, back, heard.append, 10)
        client.subscribe(out, type_name)
        client.advertise(back, type_name)
        end = time.monotonic() + 15
        while time.monotonic() < end and not (client.messages.get(out) and heard):
            publisher.publish(message)
            client.publish(back, message)
            ros.spin(0.2)
        came = client.messages.get(out, [])
        got = essence(deserialize_message(came[-1], kind)) if came else None
        row(f"TCP: {type_name} from rclpy", "as sent", "as sent" if came else "nothing", came and got == essence(message))
        row(f"TCP: {type_name} to rclpy", "as sent", "as sent" if heard else "nothing",
            heard and essence(heard[-1]) == essence(message))


def both_ways(ros, client):
    """A topic that the client publishes and reads itself: ROS gets each message."""
    name, count = "/interop/both_ways", 200
    heard = set()
    ros.node.create_subscription(String, name, lambda message: heard.add(message.data), 10)
    client.subscribe(name, "std_msgs/String")
    client.advertise(name, "std_msgs/String")
    end = time.monotonic() + 15
    while not heard and time.monotonic() < end:
        client.publish(name, String(data="first"))
        ros.spin(0.2)
    for number in range(count):
        client.publish(name, String(data=str(number)))
        ros.spin(0.02)
    ros.spin(2, lambda: len(heard) > count)
    got = len(heard - {"first"})
    row("TCP: a topic that its client reads too, to rclpy", f"{count} messages", f"{got} messages", got == count)


def fleets_topics(client):
    def newest(topic, type_name):
        client.subscribe(topic, type_name)
        end = time.monotonic() + 20
        while time.monotonic() < end and not client.messages.get(topic):
            time.sleep(0.05)
        return (client.messages.get(topic) or [None])[-1]

    grid = newest("/map", "nav_msgs/OccupancyGrid")
    cells = len(deserialize_message(grid, OccupancyGrid).data) if grid else 0
    row("TCP: /map to a late client", "some cells", cells, cells)
    # tf2_msgs has no Python package outside ROS: a TFMessage begins with the number of its transforms.
    fixed = newest("/tf_static", "tf2_msgs/TFMessage")
    count = struct.unpack("<I", fixed[4:8])[0] if fixed else 0
    row("TCP: /tf_static to a late client", "the fixed transforms of 2 robots", count, count >= 6)


def set_bool(request, response=None):
    response = response or SetBool.Response()
    response.success, response.message = request.data, "set"
    return response


def trigger(_, response=None):
    response = response or Trigger.Response()
    response.success, response.message = True, "triggered"
    return response


def plan(count):
    def reply(request, response=None):
        response = response or GetPlan.Response()
        response.plan = path(count)
        response.plan.header.frame_id = request.start.header.frame_id
        return response
    return reply


# Kind, type's name, request, server (a plan's length depends on the direction), what makes the response out.
def services(length):
    request = GetPlan.Request()
    request.start.header.frame_id = "map"
    return [
        (SetBool, "std_srvs/SetBool", SetBool.Request(data=True), set_bool, lambda r: (r.success, r.message)),
        (Trigger, "std_srvs/Trigger", Trigger.Request(), trigger, lambda r: (r.success, r.message)),
        (Empty, "std_srvs/Empty", Empty.Request(), lambda _, r=None: r or Empty.Response(), lambda r: ()),
        (GetPlan, "nav_msgs/GetPlan", request, plan(length), lambda r: (len(r.plan.poses), r.plan.header.frame_id)),
    ]


def tcp_calls_ros(ros, client):
    for kind, type_name, request, reply, essence in services(POSES):
        name = f"/interop/ros_{kind.__name__.lower()}"
        server = ros.node.create_service(kind, name, reply)
        client.use(name, type_name)
        answer = None
        for _ in range(5):
            answer = client.call(name, kind, request, 3, also=ros.spin)
            if answer:
                break
            ros.spin(0.5)
        row(f"TCP calls {type_name} of rclpy", "its response", answer and essence(answer),
            answer is not None and essence(answer) == essence(reply(request)))
        ros.node.destroy_service(server)
        ros.spin(1.5)
        client.texts.clear()
        answer = client.call(name, kind, request, 1.5, also=ros.spin)
        row(f"TCP calls {type_name} after its server has left", "an error, no response",
            f"{answer}, {client.texts[-1:]}", answer is None and any("nobody offers" in text for text in client.texts))


def ros_calls_tcp(ros, client):
    for kind, type_name, request, reply, essence in services(FEW_POSES):
        name = f"/interop/tcp_{kind.__name__.lower()}"
        client.serve(name, type_name, kind, reply)
        answer = ros.call(kind, name, request)
        row(f"rclpy calls {type_name} of TCP", "its response", answer and essence(answer),
            answer is not None and essence(answer) == essence(reply(request)))
        answers = [ros.call(kind, name, request) for _ in range(3)]
        row(f"rclpy calls {type_name} of TCP three times", "three responses", sum(a is not None for a in answers),
            all(a is not None for a in answers))
    client.serve("/interop/silent", "std_srvs/Empty", Empty, lambda _: None)
    answer = ros.call(Empty, "/interop/silent", Empty.Request(), 2)
    row("rclpy calls a service that TCP does not answer", "no response", answer, answer is None)


def slams_services(client):
    for wanted in (True, False):
        client.use("/robot1/pause", "std_srvs/SetBool")
        answer = client.call("/robot1/pause", SetBool, SetBool.Request(data=wanted))
        row(f"TCP calls /robot1/pause {wanted}", "success", answer and (answer.success, answer.message),
            answer is not None and answer.success)


def main(port):
    rclpy.init()
    ros, client = Ros(), Client(port)
    topics(ros, client)
    both_ways(ros, client)
    fleets_topics(client)
    tcp_calls_ros(ros, client)
    ros_calls_tcp(ros, client)
    slams_services(client)
    client.close()
    ros.node.destroy_node()
    rclpy.shutdown()


main(int(sys.argv[1]))
