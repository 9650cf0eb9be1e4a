"""All shipped scenarios with settings for short runs and early attacks."""

import inspect
from typing import Any

from mast_zenoh.config import bundle, loading

#: By name, variants with other settings; other scenarios are played unchanged.
VARIANTS: dict[str, list[tuple[str, ...]]] = {
    "uncoordinated": [("fraction_translations=0.3",)],
    "congested": [("n_mobile=6",)],
    "coordinated": [("fraction_translations=0.3", "reselect_every_s=1.5")],
    "realistic_network": [
        ("attack=none",),
        ("attack=uncoordinated", *(f"adversaries.adversary_{k}.attack.start_s=0.5" for k in (1, 2))),
        (
            "attack=coordinated",
            *(f"adversaries.adversary_{k}.attack.start_s=0.5" for k in (1, 2)),
            "coordinator.coordination.start_s=0.5",
        ),
    ],
    "attack_during_partition": [("partition_s=1.0", "partition_until_s=2.0", "kill_s=2.4", "restart_after_s=0.6")],
    "two_hosts": [("partition_s=0", "run.mode=lockstep")],
    "hide_object": [("attack_start_s=2.0",)],  # it selects its target once, when tracks of real objects must exist
    "defended": [
        (),
        ("attack=Replay", "wires=detections pose tracks view"),
        ("attack=StatePerturbation",),
        ("attack=PoseDrift", "wires=pose"),
        ("attack=TrustFlip", 'compromised=["ego"]'),
        ("attack=Collusion", "knowledge=trust", "n_adversaries=3", "coordinator.coordination.budget=9.0"),
    ],
    "driving": [
        ("attack=GhostAhead",),
        ("attack=SeizedCommands",),
        ("attack=stale_picture", "wire=tracks", "defence=FaultOrLie"),
        ("attack=hidden_leader",),
    ],
    "defence_cell": [("defence=FaultOrLie", "attack=BlindSpot", "placement=random")],
    "sybil": [("run.mode=lockstep", "run.record=True")],
    "rogue": [("run.mode=lockstep", "run.record=True")],
}


def every() -> list[tuple[str, ...]]:
    """(name, setting, …) of each."""
    variants = []
    for path in sorted((bundle.ROOT / "scenarios").glob("*.py")):
        parameters = inspect.signature(loading.function("scenarios", path.stem, "scenario")[1]).parameters
        for more in VARIANTS.get(path.stem, [()]):
            own_start = any(setting.startswith("attack_start_s=") for setting in more)
            early = ("attack_start_s=0.5",) if "attack_start_s" in parameters and not own_start else ()
            variants.append((path.stem, *early, *more))
    return variants


def label(variant: Any) -> str:
    """The test id of a variant."""
    return "-".join(word.rpartition("=")[2] for word in variant if "." not in word.partition("=")[0])


#: Scenarios in which no interposer changes anything.
HARMLESS = ("baseline", "congested", "passthrough", "peers", "rates", "sybil", "two_centres", "two_hosts")
