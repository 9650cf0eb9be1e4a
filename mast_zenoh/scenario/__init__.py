"""Reads scenario files and resolves all that a run needs before processes start.

    mast_zenoh.config.loading     runs the user's file
    reading     load: calls its `scenario(...)` with the launch-time parameters, and applies dotted settings; valid keys
    nodes       the nodes of the run, and what attackers know about the scene
    timeline    links, faults and attacks over time
    cooperation    options of peers and centres, and the maps that they need, fit each other
    resolution  resolve: prepares the scene, builds every node once, and resolves the key of every port

The result is a `mast_zenoh.config.resolved.Resolved`: processes get that as JSON, never the Python file.
"""

from mast_zenoh.scenario.reading import (
    MODES,
    RUN_DEFAULTS,
    agents_of,
    checked_name,
    choose_scene,
    load,
    load_values,
    victims_of,
)
from mast_zenoh.scenario.resolution import resolve

__all__ = ["MODES", "RUN_DEFAULTS", "agents_of", "checked_name", "choose_scene", "load", "load_values", "resolve"]
__all__ += ["victims_of"]
