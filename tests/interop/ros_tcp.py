"""A client of the bridge's TCP port, as Unity's ROS-TCP-Connector is one: messages are rclpy's, encoded as CDR."""

import json
import socket
import struct
import threading
import time

from rclpy.serialization import deserialize_message, serialize_message


class Client:
    """One connection. A thread reads it: `messages` and `texts` have what came, services are answered there."""

    def __init__(self, port):
        self.socket = socket.create_connection(("127.0.0.1", port), timeout=10)
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.socket.settimeout(None)
        self.lock = threading.Lock()
        self.messages, self.texts, self.responses, self.services = {}, [], {}, {}
        self.last_call = 100
        threading.Thread(target=self.read, daemon=True).start()

    def close(self):
        self.socket.shutdown(socket.SHUT_RDWR)
        self.socket.close()

    def write(self, *frames):
        """Writes frames of name and payload without others between them."""
        data = b"".join(struct.pack("<I", len(name.encode())) + name.encode() + struct.pack("<I", len(payload)) + payload
                        for name, payload in frames)
        with self.lock:
            self.socket.sendall(data)

    def command(self, command, **fields):
        self.write((command, json.dumps(fields).encode()))

    def exactly(self, count):
        data = bytearray()
        while len(data) < count:
            more = self.socket.recv(count - len(data))
            if not more:
                raise ConnectionError
            data += more
        return bytes(data)

    def read(self):
        number = None
        try:
            while True:
                name = self.exactly(*struct.unpack("<I", self.exactly(4))).decode()
                payload = self.exactly(*struct.unpack("<I", self.exactly(4)))
                if name in ("__request", "__response"):
                    number = (name, json.loads(payload.rstrip(b"\0"))["srv_id"])
                elif name in ("__warn", "__error"):
                    self.texts.append(json.loads(payload.rstrip(b"\0"))["text"])
                elif number:
                    (kind, call), number = number, None
                    if kind == "__response":
                        self.responses[call] = payload
                    else:
                        self.answer(name, call, payload)
                elif not name.startswith("__"):
                    self.messages.setdefault(name, []).append(payload)
        except (ConnectionError, OSError):
            pass

    def answer(self, service, call, payload):
        kind, reply = self.services[service]
        response = reply(deserialize_message(payload, kind.Request))
        if response is not None:
            self.write(("__response", json.dumps({"srv_id": call}).encode()), (service, serialize_message(response)))

    def subscribe(self, topic, type_name):
        self.command("__subscribe", topic=topic, message_name=type_name)

    def advertise(self, topic, type_name):
        self.command("__publish", topic=topic, message_name=type_name, queue_size=10, latch=False)

    def publish(self, topic, message):
        self.write((topic, serialize_message(message)))

    def serve(self, service, type_name, kind, reply):
        """Offers a service. `reply` returns the response to a request, or none."""
        self.services[service] = (kind, reply)
        self.command("__unity_service", topic=service, message_name=type_name)

    def use(self, service, type_name):
        self.command("__ros_service", topic=service, message_name=type_name)

    def call(self, service, kind, request, seconds=10, also=lambda: time.sleep(0.01)):
        """The response, or none; `also` is done again and again meanwhile."""
        self.last_call += 1
        call = self.last_call
        self.write(("__request", json.dumps({"srv_id": call}).encode()), (service, serialize_message(request)))
        until = time.monotonic() + seconds
        while call not in self.responses and time.monotonic() < until:
            also()
        payload = self.responses.pop(call, None)
        try:
            return payload and deserialize_message(payload, kind.Response)
        except Exception:  # A response without fields tells that the call failed.
            return None
