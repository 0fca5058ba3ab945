"""The bridge as robo-ws-bridge sees it: a client of the Foxglove WebSocket protocol in Python, by others.

usage: page-oracle.py URL    Topics, messages, parameters, a published goal's topic, services, and a call that fails.
"""

import asyncio
import sys

from robo_ws_bridge import WebSocketBridgeClient
from robo_ws_bridge.client import ServiceCallError

# What has not come by then never comes, seconds.
WAIT_S = 30.0
# Topics on which a fleet at rest publishes, or has published.
EXPECTED = {"/robot1/scan", "/robot2/odom", "/tf", "/merged_map"}
# A request without fields in CDR: the header, and the byte of an empty structure.
EMPTY = bytes([0, 1, 0, 0, 0])


async def until(what, is_so):
    """Waits until something is so."""
    end = asyncio.get_running_loop().time() + WAIT_S
    while not is_so():
        assert asyncio.get_running_loop().time() < end, f"waited in vain: {what}"
        await asyncio.sleep(0.02)


async def check(url):
    received, statuses = {}, []
    client = WebSocketBridgeClient(url.replace("http", "ws", 1), subprotocol="foxglove.sdk.v1")
    client.on_message(lambda channel, timestamp, payload: received.setdefault(channel["topic"], (timestamp, bytes(payload))))
    client.on_status(lambda *status: statuses.append(status) if status[0] == 2 else None)
    await client.connect()
    await until("topics", lambda: EXPECTED <= {channel["topic"] for channel in client.channels.values()})
    assert set(client.server_info["capabilities"]) == {"clientPublish", "parameters", "parametersSubscribe", "services"}, client.server_info

    for topic in EXPECTED:
        await client.subscribe(topic)
    await until("messages", lambda: EXPECTED <= set(received))
    assert all(payload[:2] == b"\x00\x01" for _, payload in received.values()), "CDR, little-endian"
    assert received["/robot1/scan"][0] > 0

    parameters = {parameter["name"]: parameter["value"] for parameter in await client.get_parameters(["/mr_slam/time"])}
    assert parameters["/mr_slam/time"] > 0, parameters

    await until("services", lambda: client.services)
    services = {service["name"]: service for service in client.services.values()}
    assert services["/robot1/clear_closures"]["type"] == "std_srvs/srv/Trigger", services["/robot1/clear_closures"]
    response = await client.call_service(services["/robot1/clear_closures"]["id"], EMPTY, encoding="cdr", timeout=WAIT_S)
    assert response.encoding == "cdr" and response.payload[4] == 1, response
    try:
        # A name that leads out of the run's folder.
        name = b"../x\x00"
        request = bytes([0, 1, 0, 0]) + len(name).to_bytes(4, "little") + name
        await client.call_service(services["/robot1/slam_toolbox/save_map"]["id"], request, encoding="cdr", timeout=WAIT_S)
        raise AssertionError("a call that cannot be done has a response")
    except ServiceCallError as error:
        assert "leads out of the folder for saved files" in str(error), error
    assert statuses == [], statuses
    await client.disconnect()


asyncio.run(asyncio.wait_for(check(sys.argv[1]), 90))
print("robo-ws-bridge: topics, messages, parameters and services as the protocol has them")
