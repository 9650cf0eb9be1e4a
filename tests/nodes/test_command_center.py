"""The command centre makes one picture of each batch."""

import numpy as np
import pytest
from tiny_world import PERIOD_NS, Bench, states, tiny

from mast_zenoh.messages.schemas import text


@pytest.fixture(scope="module")
def resolved():
    return tiny()


def batch(*places_by_agent: tuple[tuple[float, float], ...]) -> dict[str, np.ndarray]:
    """Columns of a batch: the tracks of each agent in turn."""
    n = [len(places) for places in places_by_agent]
    tracks = states(*(place for places in places_by_agent for place in places))
    return tracks.columns() | {
        "agent": np.repeat(np.arange(len(n)), n),
        "agents": text([f"agent_{i}" for i in range(len(n))]),
        "age_ns": np.zeros(len(n), np.int64),
    }


def test_each_batch_gives_one_picture_about_the_same_frame_and_a_second_one_none(resolved) -> None:
    centre = Bench(resolved, "command_center")
    for frame in range(3):
        assert centre.clock(frame) == []
        ((key, message),) = centre.send("collated", batch(((0.0, 0.0),), ((0.5, 0.0),)), frame)
        assert key == "cc/picture"
        assert (message.header.frame, message.header.time_ns) == (frame, frame * PERIOD_NS)
        assert centre.send("collated", batch(((9.0, 0.0),)), frame) == []
    assert not centre.host.failures


def test_tracks_of_one_object_by_two_agents_become_one_object_with_support_two(resolved) -> None:
    centre = Bench(resolved, "command_center")
    for frame in range(5):
        centre.play(frame, collated=batch(((0.0, 0.0), (30.0, 0.0)), ((0.4, 0.0),)))
    picture = centre.heard("cc/picture")[-1].body
    by_x = np.argsort(picture["position"][:, 0])
    np.testing.assert_allclose(picture["position"][by_x, 0], [0.2, 30.0], atol=0.05)
    assert picture["support"][by_x].tolist() == [2, 1]
    ids = [message.body["id"].tolist() for message in centre.heard("cc/picture")[-2:]]
    assert ids[0] == ids[1], "ids persist"


def test_an_empty_batch_gives_an_empty_picture(resolved) -> None:
    centre = Bench(resolved, "command_center")
    for frame, empty in enumerate((batch(), batch((), ()))):
        centre.clock(frame)
        ((_, message),) = centre.send("collated", empty, frame)
        assert len(message.body["id"]) == 0
    assert not centre.host.failures


@pytest.mark.parametrize("scale", [1.0, 100.0, 1e6, 1e8])
@pytest.mark.parametrize("seed", range(3))
def test_implausible_tracks_still_give_a_picture(resolved, seed: int, scale: float) -> None:
    """Invalid covariances, sizes, scores and speeds from a compromised agent."""
    rng = np.random.default_rng(seed)
    centre = Bench(resolved, "command_center")
    for frame in range(8):
        n = int(rng.integers(0, 20))
        honest = batch(((0.0, 0.0),), ((0.1, 0.0),))
        forged = {
            "id": rng.permutation(n) - 5,
            "position": rng.normal(size=(n, 3)) * scale,
            "velocity": rng.normal(size=(n, 3)) * scale,
            "size": rng.normal(size=(n, 3)) * scale,
            "yaw": rng.normal(size=n) * scale,
            "covariance": rng.normal(size=(n, 9, 9)) * scale * rng.integers(0, 2),
            "score": rng.normal(size=n) * scale,
            "class_id": rng.integers(0, 7, n).astype(np.uint8),
            "agent": np.full(n, 2),
        }
        body = honest | {name: np.concatenate([honest[name], column]) for name, column in forged.items()}
        body |= {"agents": text(["a", "b", "mallory"]), "age_ns": np.zeros(3, np.int64)}
        centre.play(frame, collated=body)
    assert not centre.host.failures
    pictures = centre.heard("cc/picture")
    assert len(pictures) == 8
    if scale <= 100.0:
        places = pictures[-1].body["position"][:, :2]
        assert np.hypot(*(places - [0.05, 0.0]).T).min() < 1.0, "and it contains the honest agents' car"


def test_the_picture_of_a_late_batch_belongs_to_the_batchs_frame(resolved) -> None:
    centre = Bench(resolved, "command_center")
    centre.clock(0)
    centre.clock(1)
    ((_, message),) = centre.send("collated", batch(((0.0, 0.0),)), 0, step=1)
    assert message.header.frame == 0
