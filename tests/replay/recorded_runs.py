"""Runs of the tiny world to record and replay."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from tiny_world import tiny

from mast_zenoh.launch import run as launcher

FRAMES = 16

Edit = Callable[[dict[str, Any]], None]


def lossy(content: dict[str, Any]) -> None:
    """Links that delay, lose and duplicate messages in both directions, and a broker that waits."""
    rules = [
        dict(type="Delay", mean_s=0.12, jitter_s=0.1, distribution="normal"),
        dict(type="Loss", probability=0.2),
        dict(type="Duplicate", probability=0.2),
    ]
    content["links"] = {"*": dict(up=rules, down=rules)}


def crashing(content: dict[str, Any]) -> None:
    """An agent leaves and returns, and the command centre is killed and started again, on lossy links."""
    lossy(content)
    content["faults"] = [
        dict(type="Restart", at=0.3, down_s=0.4, node="infra_2"),
        dict(type="Kill", at=0.8, restart_after=0.2, node="command_center"),
    ]


#: By name: scenario, settings, and a change of its content.
RUNS: dict[str, tuple[str, tuple[str, ...], Edit | None]] = {
    "baseline": ("baseline", (), None),
    "uncoordinated": ("uncoordinated", ("attack_start_s=0.3", "n_adversaries=1"), None),
    "coordinated": ("coordinated", ("attack_start_s=0.3",), None),
    "defended": ("defended", ("attack_start_s=0.3", "defence=KOfN", "attack=Collusion"), None),
    "downlink": ("downlink", ("attack_start_s=0.3",), None),
    "lossy": ("coordinated", ("attack_start_s=0.3",), lossy),
    "crashing": ("baseline", (), crashing),
    "rates": ("rates", (), None),
}


def record(name: str, folder: Path) -> Path:
    """Play a run of RUNS in one process; returns its folder."""
    scenario, settings, edit = RUNS[name]
    resolved = tiny(scenario, *settings, frames=FRAMES, edit=edit, record=True)
    ended = launcher.run(resolved, folder, runtime="inproc")
    assert ended.error is None
    return ended.folder
