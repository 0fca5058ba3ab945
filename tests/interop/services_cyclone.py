"""Services between a ros_tcp client of a running fleet and CycloneDDS as ROS 2 uses it: the request's identity stands in the
payload (rmw_cyclonedds). `services_cyclone.py PORT`"""

import os
import sys
import time
from dataclasses import dataclass

from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import int64, uint8, uint64
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from std_srvs.srv import Trigger

from idl import RELIABLE, take
from report import row
from ros_tcp import Client


@dataclass
class TriggerRequest(IdlStruct, typename="std_srvs::srv::dds_::Trigger_Request_"):
    guid: uint64
    sequence: int64
    structure_needs_at_least_one_member: uint8


@dataclass
class TriggerResponse(IdlStruct, typename="std_srvs::srv::dds_::Trigger_Response_"):
    guid: uint64
    sequence: int64
    success: bool
    message: str


def ends(participant, name, is_server):
    """Reader and writer of a service's server or client."""
    requests = Topic(participant, f"rq{name}Request", TriggerRequest)
    replies = Topic(participant, f"rr{name}Reply", TriggerResponse)
    heard, said = (requests, replies) if is_server else (replies, requests)
    return DataReader(participant, heard, qos=RELIABLE), DataWriter(participant, said, qos=RELIABLE)


def main(port):
    participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
    client = Client(port)

    requests, replies = ends(participant, "/cyclone/trigger", is_server=True)

    def serve():
        for request in take(requests, 0.05):
            replies.write(TriggerResponse(request.guid, request.sequence, True, "by Cyclone"))

    client.use("/cyclone/trigger", "std_srvs/Trigger")
    answer = None
    for _ in range(8):
        answer = client.call("/cyclone/trigger", Trigger, Trigger.Request(), 2, also=serve)
        if answer:
            break
        time.sleep(0.3)
    row("TCP calls a service on Cyclone", "its response", answer and answer.message,
        answer is not None and answer.message == "by Cyclone")

    def reply(_):
        return Trigger.Response(success=True, message="by TCP")

    client.serve("/tcp/trigger", "std_srvs/Trigger", Trigger, reply)
    for name, label in (("/tcp/trigger", "a TCP client's service"), ("/robot2/relocalize", "SLAM's service")):
        replies, requests = ends(participant, name, is_server=False)
        answers, sequence = [], 0
        end = time.monotonic() + 15
        while time.monotonic() < end and not answers:
            sequence += 1
            requests.write(TriggerRequest(4711, sequence, 0))
            answers += [a for a in take(replies, 0.5) if a.guid == 4711]
        row(f"Cyclone calls {label}", "its response", answers[0].message if answers else "none",
            answers and 1 <= answers[0].sequence <= sequence and answers[0].success)
    client.close()


main(int(sys.argv[1]))
