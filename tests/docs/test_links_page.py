"""The example of docs/links.md puts a link on the stated wire."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mast_zenoh import scenario
from mast_zenoh.wiring.model import Wiring

PAGE = (Path(__file__).parents[2] / "docs" / "links.md").read_text(encoding="utf-8")


def test_the_link_of_the_page_is_on_the_detections_of_the_ego() -> None:
    (example,) = re.findall(r"^## On other wires\n.*?^```python\n(.*?)^```$", PAGE, flags=re.S | re.M)
    names: dict[str, Any] = {}
    exec(example, names)
    path, content = scenario.load("baseline", ["n_infrastructure=1"])
    resolved = scenario.resolve(path, content | names["lossy_cable"], frames=2)
    on = {wire.key: wire.interposers for wire in Wiring.from_json(resolved.wiring).wires if wire.interposers}
    assert on == {"agent/ego/detections": ("sensor_cable",)}
