"""docs/sensors.md works as written."""

import inspect
import re
from pathlib import Path
from typing import Any

import pytest

from mast_zenoh.config import registry
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.scenes.making.sensor_types import Sensor

PAGE = (Path(__file__).parents[2] / "docs" / "sensors.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```python\n(.*?)^```$", PAGE, flags=re.S | re.M)
RADAR = "agent/infra_1/detections/radar"


def test_every_block_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for block in BLOCKS:
        exec(compile(block, "sensors.md", "exec"), names)
    times = names["road"].agent("infra_1").detections.column("time_s").unique().to_pylist()
    assert times[:3] == pytest.approx([0.07, 0.27, 0.47])
    pole = names["run"].agent("infra_1")
    assert pole.detections_of("lidar").equals(pole.detections)
    with pytest.raises(ConfigurationError, match="infra_1: no sensor 'rada'; did you mean 'radar'"):
        pole.detections_of("rada")
    attacks = names["run"].attacks.to_pandas()
    assert set(attacks["wire"]) == {RADAR}
    assert {"inserted"} <= set(attacks[attacks["interposer"] == "liar"]["effect"])
    assert set(attacks[attacks["interposer"] == "cable"]["effect"]) == {"dropped"}


def test_the_page_names_every_type_and_parameter_of_a_sensor() -> None:
    named = set(re.findall(r"`(\w+)`", PAGE))
    assert registry.known_types(Sensor).keys() <= named
    assert inspect.signature(Sensor).parameters.keys() <= named
