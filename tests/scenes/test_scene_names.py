"""Short names of scenes."""

import pytest

from mast_zenoh.errors import ConfigurationError
from mast_zenoh.scenes import parse_scene


@pytest.mark.parametrize(
    ("text", "spec"),
    [
        ("intersection", {"type": "Intersection"}),
        ("intersection:7", {"type": "Intersection", "scene_index": 7}),
        ("avstack:/data/run-0", {"type": "AVstackScene", "path": "/data/run-0"}),
        ("av2:logs/a:b", {"type": "AV2Log", "path": "logs/a:b"}),
        ("commonroad:USA.xml", {"type": "CommonRoadScenario", "path": "USA.xml"}),
        ("kitti:training", {"type": "KittiTracking", "path": "training"}),
        ("sumo:fcd.xml.gz", {"type": "SumoTrace", "path": "fcd.xml.gz"}),
    ],
)
def test_short_names_are_parsed_to_configurations(text: str, spec: dict) -> None:
    assert parse_scene(text) == spec


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("sumo:", "no path, expected sumo:PATH"),
        ("avstack", "no path, expected avstack:PATH"),
        ("av2:", "no path"),
        ("intersection:x", "not an index"),
        ("intersecton", "did you mean 'intersection'"),
        ("carla:x", "unknown name 'carla'.*known: intersection"),
        ("", "unknown name"),
    ],
)
def test_an_unknown_name_is_refused_with_the_known_ones(text: str, reason: str) -> None:
    with pytest.raises(ConfigurationError, match=reason):
        parse_scene(text)
