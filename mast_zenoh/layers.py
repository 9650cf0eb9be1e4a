"""The order of the package's layers, written once: imports only go down this list.

The import test, docs/explanation-architecture.md and the fingerprint of a version read it.
"""

from __future__ import annotations

#: Contents of each package or module, from the top layer down.
LAYERS: dict[str, str] = {
    "__init__": "the public Python API",
    "__main__": "the process: signals and standard streams, set up before slow imports",
    "cli": "the commands; each is one call into the packages below",
    "study": "sweeps, Monte Carlo, statistics, tables; attacked_run: what attackers without a role can do",
    "testing": "checks for user-written classes, and fixtures for pytest; simulation/: whole runs in virtual time",
    "api": "runs as Python objects, and listings of classes, for notebooks and scripts",
    "show": "what is seen of a run: page/ figures/ tables/ findings/ film/ templates/; export/ for other programs",
    "runs": "a run, finished or going on: its tables and frames; live/",
    "deploy": "nodes in containers and on other hosts; engine: what compose and ssh/ share",
    "launch": "starts, watches, ends the processes of a run; launcher_protocol: its decisions; replay/ checks/ netns/",
    "scenario": "validates and resolves scenario files",
    "mesh": "hosts nodes: host (one node), protocol/ (a state machine), inproc; control/, security/",
    "faults": "faults of nodes and networks on a timeline",
    "evaluation": "computes metrics and tables from the messages of a run; effects/ of interposers, on the wires",
    "config": "loading, registry, plugins, settings, the resolved scenario, paths of bundled files",
    "attacks": "the algorithms of adversaries",
    "fusion": "fuses the tracks of many agents into one picture; pipelines/ of agents and of nodes that fuse",
    "node": "base class of nodes: ports and handlers",
    "scenes": "ground truth: making/ recordings of boxes and paths; generated/ junctions. Data sets: plugins/datasets",
    "run_folder": "a run's files: bounded reading, safe writing, tables, findings; recording/ of all messages",
    "wiring": "key-expression maps, rewrites, and the key of every port",
    "integrity": "judges the agents' tracks: whom to trust, and what to withhold",
    "messages": "schemas, codec, memory layout, validation",
    "v2x": "standard messages (CAM, CPM) as wire formats, when they are sent, and the load of their channel",
    "links": "network effects: loss, delay, duplication, corruption",
    "driving": "cars that react: motion, car following, drivers, what happened to a car",
    "metrics": "compares estimates with the truth",
    "tracking": "turns detections into tracks",
    "sensing": "lidar and detector models",
    "outside": "the interface of nodes to programs outside the run, and what is counted of these",
    "gather": "collects messages from many publishers by frame",
    "arrays": "states, geometry, matching, neighbours",
    "version": "version number and fingerprint of the sources",
    "kernels": "compiled versions of a few functions",
    "streams": "named random streams",
    "errors": "the tree of all errors",
    "layers": "this list",
}

#: The lowest layer that does not affect nodes: it and those above only start nodes and read their results.
LOWEST_OUTSIDE_NODES = "launch"


def run_by_nodes() -> frozenset[str]:
    """The layers whose code decides what a node sends."""
    names = list(LAYERS)
    return frozenset(names[names.index(LOWEST_OUTSIDE_NODES) + 1 :])
