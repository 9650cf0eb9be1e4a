"""Regional centres, and the centre of centres that joins their pictures."""

from functools import cache

import numpy as np
import pytest
from tiny_world import Run, tiny

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.errors import StartError


@cache
def played(*settings: str) -> Run:
    run = Run(tiny("two_centres", *settings, infrastructure=2))
    assert not run.failures
    assert not run.rejected
    return run


def last(run: Run, key: str) -> ObjectStates:
    return ObjectStates.from_columns(run.decoded(key, "picture")[-1].body)


def test_each_centre_publishes_the_objects_of_its_region_and_the_centre_of_centres_all() -> None:
    run = played()
    west, east = (last(run, f"cc/{name}/picture") for name in ("west", "east"))
    assert len(west) > 0 < len(east)
    assert (west.position[:, 0] < 2.0).all()
    assert (east.position[:, 0] > -2.0).all()
    assert len(last(run, "cc/picture")) == 4


def frames_with(run: Run, key: str, x_m: np.ndarray) -> list[int]:
    """The frames in which a picture has an object within 1.5 m of (x, 0). x_m: (f,) m"""
    found = []
    for message in run.decoded(key, "picture"):
        place = message.body["position"]
        distance = np.hypot(place[:, 0] - x_m[message.header.frame], place[:, 1])
        found += [message.header.frame] * bool((distance < 1.5).any())
    return found


def test_an_object_keeps_its_id_as_it_crosses_the_border() -> None:
    run = played("border_m=-4.0")
    ego_x = -10.0 + 8.0 * np.arange(12) * 0.1
    west, east, joint = (frames_with(run, key, ego_x) for key in ("cc/west/picture", "cc/east/picture", "cc/picture"))
    assert west == list(range(west[0], west[-1] + 1))
    assert west[0] < east[0] <= west[-1] < east[-1] == 11, "first in the west, then on both sides, then in the east"
    assert joint == list(range(joint[0], 12))
    ids = set()
    for message in run.decoded("cc/picture", "picture")[joint[0] :]:
        place = message.body["position"]
        ids.add(int(message.body["id"][np.hypot(place[:, 0] - ego_x[message.header.frame], place[:, 1]).argmin()]))
    assert len(ids) == 1


def test_a_centre_on_board_sees_what_is_around_its_agent() -> None:
    def near(content: dict) -> None:
        content["centers"]["on_board"]["region"]["radius_m"] = 12.0
        content["centers"]["on_board"]["overlap_m"] = 0.0

    run = Run(tiny("two_centres", "on_board=true", infrastructure=2, edit=near))
    ego_x = -10.0 + 8.0 * np.arange(12) * 0.1
    for message in run.decoded("cc/on_board/picture", "picture")[1:]:
        before = ego_x[message.header.frame - 1]  # where the region is: it follows a frame later
        place = message.body["position"]
        assert (np.hypot(place[:, 0] - before, place[:, 1]) <= 12.0).all()
    assert run.results["evaluator"]["metrics"]["agents"]["ego"]["picture"]["tp"]["mean"] > 0


def test_the_picture_of_two_centres_is_as_good_as_that_of_one() -> None:
    one, two = (
        run.results["evaluator"]["metrics"]["agents"]["ego"]["picture"]
        for run in (Run(tiny("baseline", infrastructure=2)), played())
    )
    assert two["fn"]["mean"] <= one["fn"]["mean"] + 0.5
    assert two["fp"]["mean"] <= one["fp"]["mean"] + 0.5


def test_a_region_around_an_agent_needs_its_pose() -> None:
    with pytest.raises(StartError, match="wire brings `pose`"):
        Run(tiny("two_centres", 'centers.west.region={"type": "Around"}', infrastructure=4, frames=5))
