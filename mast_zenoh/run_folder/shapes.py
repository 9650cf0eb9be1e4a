"""The types in JSON files of a run folder."""

from __future__ import annotations

from typing import Any

from mast_zenoh.run_folder import finding
from mast_zenoh.wiring import model
from mast_zenoh.wiring.plain_shapes import ANY, NAMED, NUMBER, Name, check_shape

_NODE: dict[str, Any] = {
    **dict.fromkeys(("role", "ended", "log"), str),
    **dict.fromkeys(("last_frame", "restarts", "pid", "exit"), int),
    **{name: {} for name in ("rejected", "first_rejected", "foreign", "invalid_control")},
    "failures": [{}],
    "unaccepted": [str],
}
_REPLAY = {"run": str, "folder": str, "from": str, "played": [str], "live": [str], "changed": {ANY: [str]}}
_LAUNCHER = {"pid": int, "began": str, "machine": str, "boot": str, "pid_namespace": str}
_HOST = {"reach": {}, "nodes": [str], "run_folder": str}

#: By file, the types that readers rely on.
SHAPES: dict[str, Any] = {
    "run.json": {
        **dict.fromkeys(("id", "name", "status", "message", "runtime", "security", "mode", "started"), str),
        **dict.fromkeys(("endpoint", "viewer_credentials", "kernels_not_used", "engine_plugin"), str),
        **dict.fromkeys(("seed", "frames"), int),
        "rate": NUMBER,
        "command": (str, list),
        "launcher": _LAUNCHER,
        "versions": {ANY: str},
        "timings": {},
        "nodes": {NAMED: _NODE},
        "churn": [{"frame": int, "node": str, "what": str}],
        "steps": [{}],
        "recording": {"complete": bool, "from_frame": int},
        "recorded": {"messages": int, "malformed": int, "lost": int, "problem": str, "disk_full": bool},
        "notices": [finding.SHAPE | {"text": str}],
        "innovations": {ANY: {}},
        "replay": _REPLAY,
        "deployment": {"engine": str, "label": str, "stack": str, "hosts": {ANY: _HOST}},
    },
    "scenario.json": {
        "name": Name,
        "mode": str,
        "rate": NUMBER,
        **dict.fromkeys(("seed", "frames", "period_ns", "leeway_ns"), int),
        "scene": {},
        "modules": [str],
        "timeline": [{"label": str, "kind": str, "at_s": NUMBER, "until_s": NUMBER, "nodes": [str]}],
        "network": {},
        "origin": [NUMBER],
        "messages": [{}],
        "steps": [{"frame": int, "action": str, "node": str}],
        "nodes": {NAMED: {"role": str, "file": str, "type": str, "on_exit": str, "config": {}}},
    },
    "wiring.json": model.SHAPE,
    "metrics.json": {
        "agents": {ANY: {ANY: {}}},
        "same_as": {ANY: {ANY: str}},
        "scored_frames": [int],
        **{name: {ANY: {}} for name in ("latency_ms", "interposers", "achieved")},
        "messages": {ANY: {ANY: {"mean": NUMBER, "std": NUMBER}}},
        "own_metrics": {
            ANY: {"per": str, "heading": str, "unit": str, "digits": int, "whole": bool, "range": [NUMBER]}
        },
    },
    "study.json": {"name": str},
}


def check_file(content: Any, name: str) -> None:
    """Raise ValueError, with the place, unless the content of a file has the types that readers rely on."""
    if name in SHAPES:
        check_shape(content, SHAPES[name])
