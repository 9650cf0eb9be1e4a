"""The scenario of drivers on a small junction, which plays in a second."""

from collections.abc import Callable
from typing import Any

from mast_zenoh import scenario
from mast_zenoh.config.resolved import Resolved

SMALL = dict(type="Intersection", n_infrastructure=1, n_vehicles=6, n_bicycles=0, n_pedestrians=2)
ROUGH = [dict(type="Loss", probability=0.3), dict(type="Delay", mean_s=0.15)]


def driven(
    *settings: str,
    frames: int = 24,
    seed: int = 3,
    edit: Callable[[dict[str, Any]], None] | None = None,
    **options: Any,
) -> Resolved:
    """The scenario `driving` on a small junction, with an ego that moves; the driver takes over after 0.4 s."""
    path, content = scenario.load("driving", settings)
    content |= dict(scene=SMALL, world=dict(take_over_s=0.4))
    if edit:
        edit(content)
    return scenario.resolve(path, content, frames=frames, seed=seed, **options)


def over_a_rough_link(content: dict[str, Any]) -> None:
    """Put commands on a link that loses and delays them, and cut it off for a while."""
    content["links"] = {"ego": dict(up=ROUGH)}
    content["faults"] = [dict(type="Partition", at=1.2, until=1.8, node="ego")]
    content["keyexpr"] = dict(content["keyexpr"])
    content["keyexpr"]["rewrites"] = [*content["keyexpr"]["rewrites"], "network_drivers.toml"]
