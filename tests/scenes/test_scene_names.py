"""Short names of scenes."""

import pytest

from mast_zenoh.config.registry import parse_scene
from mast_zenoh.errors import ConfigurationError


@pytest.mark.parametrize(
    ("text", "spec"),
    [
        ("intersection", {"type": "Intersection"}),
        ("intersection:7", {"type": "Intersection", "scene_index": 7}),
        ("avstack:/data/run-0", {"type": "AVstackScene", "path": "/data/run-0"}),
        ("av2:logs/a:b", {"type": "AV2Log", "path": "logs/a:b"}),
        ("dair:/data/V2X-Seq-SPD/0003", {"type": "DAIRScene", "path": "/data/V2X-Seq-SPD/0003"}),
        ("rcooper:/data/RCooper", {"type": "RCooperScene", "path": "/data/RCooper"}),
        ("tumtraf:train", {"type": "TUMTrafV2X", "path": "train"}),
        ("urbaning:/data/UrbanIng-V2X", {"type": "UrbanIngV2X", "path": "/data/UrbanIng-V2X"}),
        ("opv2v:train/2021_08_16", {"type": "OPV2VScene", "path": "train/2021_08_16"}),
        ("v2xreal:test/2023", {"type": "V2XRealScene", "path": "test/2023"}),
        ("multiv2x:Town01", {"type": "MultiV2XScene", "path": "Town01"}),
        ("v2v4real:train/testoutput_0", {"type": "V2V4RealScene", "path": "train/testoutput_0"}),
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
        ("sumo:", r"no path.*sumo:PATH"),
        ("avstack", r"no path.*avstack:PATH"),
        ("av2:", "no path"),
        ("dair", r"no path.*dair:PATH"),
        ("rcooper:", r"no path.*rcooper:PATH"),
        ("intersection:x", r"'x'.*number.*intersection:SCENE_INDEX"),
        ("intersecton", "mean 'intersection'"),
        ("carla:x", r"'carla'.*intersection:SCENE_INDEX.*av2"),
        ("", "unknown name"),
    ],
)
def test_an_unknown_name_is_refused_with_the_known_ones(text: str, reason: str) -> None:
    with pytest.raises(ConfigurationError, match=reason):
        parse_scene(text)
