"""A flood fills messages up to a number of rows, and takes the place of real ones."""

import numpy as np
import pytest
from attack_worlds import SECOND, world
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.attacks import Surroundings
from mast_zenoh.attacks.flood import Flood, square_grid
from mast_zenoh.integrity.views import SweptView
from mast_zenoh.messages.limits import RowLimits
from mast_zenoh.tracking.view import SensorView

ORIGIN = np.array([7.0, -3.0, 0.0])


def flooded(attack: Flood, n: int):
    attack.inform(Surroundings())
    attack.bind(0, "adversary_1")
    return attack.step(50, 5 * SECOND, world(n), ORIGIN)


@given(st.integers(1, 400), st.integers(0, 90))
def test_a_message_has_the_rows_that_were_asked_for_with_ids_of_their_own(rows: int, n: int) -> None:
    done, own = flooded(Flood(rows=rows), n), world(n)
    after = done.applied_to(own)
    assert len(after) == max(rows, n)
    assert len(set(after.id.tolist())) == len(after)
    assert done.keep.all()
    assert len(done.report) == len(done.added)


@given(st.integers(1, 3000))
def test_cars_stand_in_a_square_around_the_victim_each_in_its_own_place(count: int) -> None:
    grid = square_grid(count)
    assert grid.shape == (count, 2)
    assert len({tuple(point) for point in grid.tolist()}) == count
    assert not (grid == 0).all(axis=1).any()
    ring = np.abs(grid).max(axis=1)
    assert np.all(np.diff(ring) >= 0)
    assert ring[-1] == int(np.ceil((np.sqrt(count + 1) - 1) / 2)), "no ring is begun before the last is full"


def test_cars_keep_their_ids_and_places_over_time() -> None:
    attack = Flood(rows=40, start_s=0.0)
    attack.inform(Surroundings())
    first, second = (attack.step(k, k * SECOND, world(5), ORIGIN).added for k in range(2))
    np.testing.assert_array_equal(first.id, second.id)
    np.testing.assert_array_equal(first.position, second.position)
    assert not first.velocity.any()
    distance = np.linalg.norm(first.position[:, None] - first.position, axis=2)[np.triu_indices(35, 1)]
    assert distance.min() == pytest.approx(3.0)


def test_a_receiver_that_cuts_the_message_drops_real_rows_first() -> None:
    own = world(20)
    columns = flooded(Flood(rows=60), 20).applied_to(own).columns()
    kept = RowLimits({"tracks": 40}).shortened("tracks", columns, "tracks")
    assert len(kept["id"]) == 40
    assert not np.isin(kept["id"], own.id).any()


def test_the_agents_view_contradicts_no_car_and_is_true_before_the_attack() -> None:
    view = SensorView(ORIGIN, np.eye(3), -np.pi, np.pi, -0.5, 0.5, 80.0)
    swept = SweptView(view, np.full((4, 12), 80.0))
    attack = Flood()
    flooded(attack, 5)
    assert not attack.forge_view(50, 5 * SECOND, swept).free.any()
    assert attack.forge_view(49, 5 * SECOND, swept) is swept
