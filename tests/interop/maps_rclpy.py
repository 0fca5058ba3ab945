"""Large and latched maps at stock Fast DDS readers. `maps_rclpy.py DOOR MR_SLAM [STOCK_1MB_S STOCK_16MB_S]`

With two times (those with stock buffers, in seconds) it measures a reader whose socket buffers are large.

An endpoint that publishes nothing but maps (bridge/examples/dds_maps.rs); map n has stamp n.
"""

import contextlib
import json
import math
import os
import pathlib
import subprocess
import sys
import time

import rclpy
from nav_msgs.msg import OccupancyGrid
from rclpy.qos import DurabilityPolicy, QoSProfile

from report import row

LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
DOOR, BINARY = sys.argv[1:3]


class Door:
    """The example, publishing `count` maps of `side` x `side` cells."""

    def __init__(self, side, period_s, count):
        command = [DOOR, os.environ["ROS_DOMAIN_ID"], str(side), str(period_s), str(count)]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.said = 0

    def until(self, count):
        """Waits until map `count` was handed over."""
        while self.said < count:
            line = self.process.stdout.readline()
            assert line, "the door ended"
            self.said = int(line.split()[1])

    def rss_mb(self):
        fields = pathlib.Path(f"/proc/{self.process.pid}/status").read_text().splitlines()
        return next(int(f.split()[1]) / 1000 for f in fields if f.startswith("VmRSS"))

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.stdin.close()
        self.process.wait(10)


class Maps:
    """A subscriber that keeps the stamps and arrival times of what comes."""

    def __init__(self, node, topic="/robot1/map"):
        self.node, self.stamps, self.times, self.sizes = node, [], [], []
        self.begun = time.monotonic()
        self.subscription = node.create_subscription(OccupancyGrid, topic, self.hear, LATCHED)

    def hear(self, grid):
        self.stamps.append(grid.header.stamp.sec)
        self.times.append(time.monotonic() - self.begun)
        self.sizes.append(len(grid.data))

    def wait(self, seconds, enough=1):
        until = time.monotonic() + seconds
        while time.monotonic() < until and len(self.stamps) < enough:
            rclpy.spin_once(self.node, timeout_sec=0.02)

    def end(self):
        self.node.destroy_subscription(self.subscription)


def late_joiners(node):
    with Door(200, 0.1, 60) as door:
        door.until(60)
        first = Maps(node)
        first.wait(5)
        first.wait(1.0, enough=99)
        row("60 maps before anyone came: the first late joiner gets", "the newest, once", first.stamps,
            first.stamps == [60])
        second = Maps(node)
        second.wait(5)
        second.wait(1.0, enough=99)
        row("the second late joiner gets", "the newest, once", second.stamps, second.stamps == [60])
        first.end()
        second.end()
    with Door(200, 0.2, 30) as door:
        first = Maps(node)
        door.until(1)
        first.wait(30, enough=25)
        while not first.stamps or first.stamps[-1] < 30:
            first.wait(1, enough=len(first.stamps) + 1)
        # The newest counts: one that is not taken when the next one comes is passed over.
        sound = first.stamps == sorted(first.stamps) and len(set(first.stamps)) >= 20
        row("30 maps at 5 Hz to one who is there", ">= 20, in order, the last", f"{len(set(first.stamps))}", sound)
        second = Maps(node)
        second.wait(5)
        second.wait(1.0, enough=99)
        row("a late joiner beside one who is there gets", "the newest, once", second.stamps, second.stamps == [30])
        first.end()
        second.end()


@contextlib.contextmanager
def busy_machine():
    """Two processes that take all the processor time they get."""
    processes = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()


def late_joiners_of_a_busy_machine(node, tries=5):
    """The endpoint must drop its old messages before a reader that has just come asks for them: a race with DDS."""
    received = []
    with busy_machine():
        for _ in range(tries):
            with Door(200, 0.1, 10) as door:
                first = Maps(node)
                door.until(1)
                until = time.monotonic() + 10
                while 10 not in first.stamps and time.monotonic() < until:
                    first.wait(1, enough=len(first.stamps) + 1)
                second = Maps(node)
                second.wait(5)
                second.wait(0.5, enough=99)
                received.append(second.stamps)
                first.end()
                second.end()
    right = sum(stamps == [10] for stamps in received)
    row("late joiners beside one who is there, machine busy", f"the newest, once, {tries - 1} of {tries} times",
        received, right >= tries - 1)


def memory():
    with Door(1000, 0.05, 200) as door:
        door.until(20)
        early = door.rss_mb()
        door.until(200)
        late = door.rss_mb()
    row("memory over 180 maps of 1 MB nobody reads", "<= 8 MB more", f"{late - early:+.1f} MB", late - early <= 8)


# (cells on a side, label, longest time in seconds with the setting that `mr-slam doctor` asks for)
SIZES = ((1000, "1 MB", 1.0), (4096, "16 MB", 5.0))


def time_of(node, side, limit_s, tries):
    """Seconds until a late joiner has the map, infinite if it never comes whole; the best of some tries unless one is
    good enough, because the machine may have other things to do, and what a buffer does not hold is repaired."""
    best = float("inf")
    for _ in range(tries):
        with Door(side, 1.0, 1) as door:
            door.until(1)
            maps = Maps(node)
            maps.wait(30)
            best = min(best, maps.times[0] if maps.sizes[:1] == [side * side] else float("inf"))
            maps.end()
        if best <= limit_s:
            break
    return best


def times_with_setting(node, stock_s):
    """This process's sockets have the size that the setting gives every process, as far as net.core.rmem_max lets
    them. A buffer that holds the map has to bring it within the limit. What a smaller one drops is repaired, which
    takes as long as the machine's other work lets it: there it has to be faster than with stock buffers."""
    with open("/proc/sys/net/core/rmem_max") as file:
        largest_bytes = int(file.read())
    for (side, label, limit_s), stock in zip(SIZES, stock_s):
        if largest_bytes < side * side and math.isfinite(stock):
            limit_s = max(limit_s, stock)
            wanted = f"<= {limit_s:g} s of stock buffers, as net.core.rmem_max is {largest_bytes / 1e6:.1f} MB"
        else:
            wanted = f"<= {limit_s:g} s"
        took = time_of(node, side, limit_s, 5)
        row(f"{label} map to a late joiner with large buffers", wanted, f"{took:.2f} s", took <= limit_s)


def times(node):
    doctor = subprocess.run([BINARY, "doctor", "--json"], capture_output=True, text=True)
    checks = {c["name"]: c for c in json.loads(doctor.stdout)["checks"]}
    buffer = checks["udp receive buffer"]
    row("doctor judges the receive buffer", "a verdict and what to do", f"{buffer['state']}: {buffer['found']}",
        buffer["state"] in ("ok", "warning") and (buffer["state"] == "ok" or "sysctl" in buffer["advice"]))
    for side, label, limit_s in SIZES:
        excused = buffer["state"] != "ok"
        # Without the setting one try shows how long it takes.
        took = time_of(node, side, float("inf") if excused else limit_s, 3)
        wanted = f"<= {limit_s:g} s" + (" with the setting doctor asks for, which is not made here" if excused else "")
        row(f"{label} map to a late joiner", wanted, f"{took:.2f} s", took <= limit_s or (excused and math.isfinite(took)))


def main():
    rclpy.init()
    node = rclpy.create_node("interop_maps")
    if len(sys.argv) > 3:
        times_with_setting(node, [float(seconds) for seconds in sys.argv[3:5]])
    else:
        late_joiners(node)
        late_joiners_of_a_busy_machine(node)
        memory()
        times(node)
    node.destroy_node()
    rclpy.shutdown()


main()
