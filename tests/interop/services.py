"""SLAM's services from ROS 2, on a running fleet of two robots: the types that rclpy has."""

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


def main():
    rclpy.init()
    node = rclpy.create_node("interop_services")
    for wished in (True, False):
        answer = call(node, SetBool, "/robot2/pause", SetBool.Request(data=wished))
        row(f"/robot2/pause {wished}", "an answer", answer and (answer.success, answer.message), answer is not None)
    answer = call(node, Trigger, "/robot2/clear_closures", Trigger.Request())
    row("/robot2/clear_closures", "an answer", answer and (answer.success, answer.message), answer is not None)
    node.destroy_node()
    rclpy.shutdown()


main()
