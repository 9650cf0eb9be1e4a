"""The launcher of a run in a swarm, as a program that can be killed.

python swarm_launch.py IMAGE '{"frames": 60, "mode": "realtime", "secure": "acl", "faults": [], …}' OUT
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from mast_zenoh import scenario
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.deploy.swarm import Swarm
from mast_zenoh.launch import run


def resolved(
    frames: int = 5,
    mode: str = "lockstep",
    faults: Sequence[dict[str, Any]] = (),
    name: str = "uncoordinated",
    settings: Sequence[str] = ("n_infrastructure=2", "n_adversaries=1", "attack_start_s=0.1"),
) -> Resolved:
    path, loaded = scenario.load(name, settings)
    loaded = loaded | (dict(faults=list(faults)) if faults else {})
    return scenario.resolve(path, loaded, frames=frames, mode=mode, record=True)


if __name__ == "__main__":
    image, options, out = sys.argv[1:]
    told: dict[str, Any] = json.loads(options)
    secure = told.pop("secure", "open")
    ended = run.run(resolved(**told), Path(out), engine=Swarm(image, patience_s=10.0), secure=secure)
    if ended.error:
        sys.stderr.write(f"{type(ended.error).__name__}: {ended.error}\n")
        sys.exit(ended.error.exit_code)
