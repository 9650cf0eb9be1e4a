"""The compose files in deploy/compose/: what `mast deploy up` would write for some of our scenarios."""

from __future__ import annotations

from mast_zenoh import scenario
from mast_zenoh.deploy.compose import document
from mast_zenoh.deploy.image import TAG

#: Name of the example: of which scenario it is, and at which level of security.
EXAMPLES = {
    "baseline": ("baseline", "open"),
    "uncoordinated": ("uncoordinated", "acl"),
    "coordinated": ("coordinated", "acl"),
    "partition": ("attack_during_partition", "open"),
}


def example(name: str) -> str:
    """The text of an example."""
    of, secure = EXAMPLES[name]
    path, loaded = scenario.load(of)
    resolved = scenario.resolve(path, loaded, record=True)
    return document.text(resolved, f"{name}-example", image=TAG, secure=secure)
