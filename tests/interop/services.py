"""SLAM's services from ROS 2, on a running fleet of two robots: the types that rclpy has. What they did is asked for
at the command line. `services.py RUN_DIR BINARY`"""

import json
import subprocess
import sys

import rclpy
from std_srvs.srv import SetBool, Trigger

from report import row


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


def main(run_dir, binary):
    rclpy.init()
    node = rclpy.create_node("interop_services")

    def ask(name, kind, request, expected):
        """`expected`: what must then be so."""
        answer = call(node, kind, f"/robot2/{name}", request)
        said = answer and (answer.success, answer.message)
        is_so = {key: state(binary, run_dir)[key] for key in expected}
        row(f"/robot2/{name}", f"success, {expected}", f"{said}, {is_so}", answer and answer.success and is_so == expected)

    ask("pause", SetBool, SetBool.Request(data=True), {"paused": True})
    ask("pause", SetBool, SetBool.Request(data=False), {"paused": False})
    ask("clear_closures", Trigger, Trigger.Request(), {"closures": 0})
    # It stands: one look is not enough to be believed.
    ask("relocalize", Trigger, Trigger.Request(), {"located": False})
    ask("reset", Trigger, Trigger.Request(), {"mode": "mapping"})
    node.destroy_node()
    rclpy.shutdown()


main(*sys.argv[1:])
