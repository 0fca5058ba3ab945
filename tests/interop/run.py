"""Runs the fleet, and ROS 2 against it: see .ci/interop. `run.py OUT`"""

import contextlib
import json
import os
import pathlib
import random
import socket
import subprocess
import sys
import tempfile

HERE = pathlib.Path(__file__).parent
ROOT = HERE.parent.parent
# INTEROP_PROFILE=debug takes the development build.
BUILD = ROOT / "target" / os.environ.get("INTEROP_PROFILE", "release")
BINARY = BUILD / "mr-slam"
ENDPOINT = BUILD / "examples/dds_maps"
# No script needs half of it; none may take more.
PEER_MAX_S = 240
# Domains whose ports lie below those that the system gives to anybody.
DOMAINS = (2, 100)

# Cyclone on loopback alone; peers are asked directly, as loopback has no multicast here.
CYCLONE = """<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>
<MaxAutoParticipantIndex>40</MaxAutoParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""


def environment(domain):
    """This machine alone, a domain of this run's own, stock Fast DDS."""
    keep = {k: v for k, v in os.environ.items() if not k.startswith(("ROS_", "FASTRTPS", "CYCLONE"))}
    return keep | {
        "ROS_DOMAIN_ID": str(domain),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp",
        "CYCLONEDDS_URI": CYCLONE,
    }


def peer(script, domain, *arguments, **variables):
    """What a script found out: rows of (what, wanted, measured, ok)."""
    command = [sys.executable, str(HERE / script), *map(str, arguments)]
    running = subprocess.Popen(command, env=environment(domain) | variables, text=True,
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    try:
        said, complained = running.communicate(timeout=PEER_MAX_S)
        tail = (complained.strip().splitlines() or ["no reason given"])[-1]
    except subprocess.TimeoutExpired:
        running.kill()
        said, complained = running.communicate()
        tail = f"not at its end after {PEER_MAX_S} s"
    rows = [json.loads(line) for line in said.splitlines() if line.startswith("{")]
    if running.returncode != 0:
        rows.append({"what": script, "wanted": "to end well", "measured": tail, "ok": False})
        sys.stderr.write(complained)
    return rows


@contextlib.contextmanager
def fleet(out, domain, port, *arguments):
    """A fleet with its ROS 2 endpoint open; its folder."""
    with tempfile.TemporaryDirectory() as run_dir, open(out / "interop-fleet.log", "a") as log:
        command = [BINARY, "up", "--port", str(port), "--ros-domain", str(domain), "--run-dir", run_dir, *arguments]
        running = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        try:
            yield run_dir
        finally:
            running.terminate()
            running.wait(20)


def free_port():
    """A TCP port that nobody listens on."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def main(out):
    domain = random.randint(*DOMAINS)
    rows = []
    port = free_port()
    with fleet(out, domain, port, "--robots", "2") as run_dir:
        rows += peer("fleet_rclpy.py", domain, run_dir)
        rows += peer("fleet_cyclone.py", domain)
        rows += peer("services.py", domain, run_dir, BINARY)
        rows += peer("tcp_rclpy.py", domain, port)
        rows += peer("services_cyclone.py", domain, port)
        rows += peer("actions.py", domain, port)
    port = free_port()
    with fleet(out, domain, port, "--robots", "2", "--world", "ros") as run_dir:
        rows += peer("world_rclpy.py", domain, port, run_dir, BINARY)
        rows += peer("world_cyclone.py", domain, run_dir, BINARY)
    with fleet(out, domain, free_port(), "--robots", "1", "--world", "ros") as run_dir:
        rows += peer("driver_cyclone.py", domain, run_dir, BINARY)
    rows += peer("maps_rclpy.py", domain, ENDPOINT, BINARY)
    profile = str(HERE / "buffers.xml")
    stock = [row["measured"].split()[0] for row in rows if row["what"].endswith(" MB map to a late joiner")]
    rows += peer("maps_rclpy.py", domain, ENDPOINT, BINARY, *stock, FASTRTPS_DEFAULT_PROFILES_FILE=profile)
    (out / "interop.json").write_text(json.dumps(rows, indent=1))
    wide = max(len(row["what"]) for row in rows)
    for row in rows:
        mark = "ok  " if row["ok"] else "MISS"
        print(f"{mark} {row['what']:<{wide}}  {row['measured']}  (wanted: {row['wanted']})")
    missed = sum(not row["ok"] for row in rows)
    print(f"interop: {len(rows) - missed} passed, {missed} failed")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main(pathlib.Path(sys.argv[1])))
