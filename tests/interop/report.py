"""Rows of the interop table, one JSON object a line, and what the fleet itself says."""

import json
import subprocess


def row(what, wanted, measured, ok):
    """One fact that must hold."""
    print(json.dumps({"what": what, "wanted": str(wanted), "measured": str(measured), "ok": bool(ok)}), flush=True)


def battery(binary, run_dir, robot):
    """What `mr-slam status` says of a robot's battery, by its index."""
    command = [binary, "status", "--json", "--run-dir", run_dir]
    said = subprocess.run(command, capture_output=True, text=True, timeout=60)
    return json.loads(said.stdout)["robots"][robot]["battery"] if said.stdout else None
