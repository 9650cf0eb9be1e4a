"""The order of the package's layers, written once: imports go down this list only.

The import test, docs/architecture.md and the fingerprint of a version read it.
"""

from __future__ import annotations

#: From the top down: what a layer holds, by its package or module.
LAYERS: dict[str, str] = {
    "__init__": "the public Python API",
    "__main__": "the process: signals and standard streams, before anything slow is imported",
    "cli": "thin: every command is one call into the packages below",
    "study": "sweeps, Monte Carlo, statistics, tables; rogue/: what attackers achieve against a run",
    "testing": "checks for classes that users write, and fixtures for pytest",
    "api": "runs as Python objects, and what a scenario can name: for notebooks and scripts",
    "report": "pages of runs and studies; figures/ tables/ narrative/ templates/",
    "deploy": "nodes that run elsewhere: an engine each in compose/, swarm/ and ssh/",
    "launch": "starts, watches and ends the processes of a run; writes the run folder; interception/ netns/",
    "checks": "what must hold in the record of a finished run",
    "runtime": "hosts nodes: host (one node, no I/O), inproc, remote_node; mesh/ lockstep/",
    "scenario": "the user's dict, checked and resolved",
    "control": "schemas of control messages: bytes to checked values",
    "faults": "what goes wrong, and when",
    "evaluation": "from the messages of a run to its metrics and tables",
    "config": "loading, registry, settings, the resolved scenario, where bundled files are",
    "effects": "what interposers did, measured on the wires",
    "attacks": "what adversaries do",
    "node": "what a node is: ports and handlers",
    "messagelog": "every message of a run as a file: written, read, compared",
    "security": "certificates of a run, rights derived from the wiring, signing keys",
    "wiring": "key-expression maps, rewrites, and the key of every port",
    "pipelines": "the stages of an agent and of the command centre, put together",
    "fusion": "tracks of many agents to one picture",
    "scenes": "where the truth comes from",
    "messages": "schemas, codec, memory layout, validation",
    "links": "what networks do to messages",
    "metrics": "estimates against truth",
    "tracking": "detections to tracks",
    "sensing": "what a lidar sees, and what a detector makes of it",
    "gather": "messages of many publishers, collected by frame",
    "arrays": "states, geometry, matching, neighbours",
    "version": "which mast-zenoh this is: number and fingerprint of its sources",
    "kernels": "compiled twins of a few functions",
    "streams": "named random streams",
    "errors": "the tree of all errors",
    "layers": "this list",
}

#: The first layer, from the top, that decides what a node does: those above only start it and read what it left.
LOWEST_OUTSIDE_NODES = "checks"


def run_by_nodes() -> frozenset[str]:
    """The layers whose code decides what a node sends."""
    names = list(LAYERS)
    return frozenset(names[names.index(LOWEST_OUTSIDE_NODES) + 1 :])
