"""The compose files in deploy/compose/, as `mast deploy write` writes them."""

from __future__ import annotations

from mast_zenoh import scenario
from mast_zenoh.deploy.compose import document
from mast_zenoh.deploy.compose.inside import PATIENCE_S
from mast_zenoh.deploy.image import TAG

#: Scenario and security level of each example.
EXAMPLES = {
    "baseline": ("baseline", "open"),
    "uncoordinated": ("uncoordinated", "acl"),
    "coordinated": ("coordinated", "acl"),
    "partition": ("attack_during_partition", "open"),
}


def example(name: str) -> str:
    """The text of an example."""
    scenario_name, secure = EXAMPLES[name]
    path, loaded = scenario.load(scenario_name)
    resolved = scenario.resolve(path, loaded, record=True)
    launcher = document.Launcher(scenario_name, sources="../..")
    return document.text(resolved, name, image=TAG, secure=secure, patience_s=PATIENCE_S, launcher=launcher)
