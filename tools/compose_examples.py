"""The files in deploy/compose/, as `mast deploy write` writes them."""

from __future__ import annotations

from mast_zenoh import scenario
from mast_zenoh.deploy import documents
from mast_zenoh.deploy.compose_inside import PATIENCE_S
from mast_zenoh.deploy.docker import TAG

#: Scenario and security level of each file in deploy/compose/.
EXAMPLES = {
    "baseline": ("baseline", "open"),
    "uncoordinated": ("uncoordinated", "acl"),
    "coordinated": ("coordinated", "acl"),
    "partition": ("attack_during_partition", "open"),
}


def example(name: str) -> str:
    """The text of a file in deploy/compose/, as `mast deploy write` writes it."""
    scenario_name, secure = EXAMPLES[name]
    path, loaded = scenario.load(scenario_name)
    resolved = scenario.resolve(path, loaded, record=True)
    launcher = documents.Launcher(scenario_name, sources="../..")
    return documents.compose_text(resolved, name, image=TAG, secure=secure, patience_s=PATIENCE_S, launcher=launcher)
