"""The deployment engines by name. An engine is imported on demand, as its dependencies may not be installed."""

from __future__ import annotations

from importlib import import_module

from mast_zenoh.errors import EngineError, nearest
from mast_zenoh.launch.engine import Engine

ENGINES = {
    "compose": "mast_zenoh.deploy.compose.engine:Compose",
    "ssh": "mast_zenoh.deploy.ssh.engine:Ssh",
    "swarm": "mast_zenoh.deploy.swarm.engine:Swarm",
}


def load(name: str) -> type[Engine]:
    """The engine of this name; raises EngineError."""
    if name not in ENGINES:
        raise EngineError(f"there is no engine {name!r}{nearest(name, ENGINES)}")
    module, _, attribute = ENGINES[name].partition(":")
    engine: type[Engine] = getattr(import_module(module), attribute)
    return engine
