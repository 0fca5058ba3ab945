"""Rows of the interop table, one JSON object a line."""

import json


def row(what, wanted, measured, ok):
    """One fact that must hold."""
    print(json.dumps({"what": what, "wanted": str(wanted), "measured": str(measured), "ok": bool(ok)}), flush=True)
