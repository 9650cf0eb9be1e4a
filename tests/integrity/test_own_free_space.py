"""`FreeSpaceVeto`: an agent leaves out what its own sensor sees through."""

from __future__ import annotations

import numpy as np
from integrity_batches import CAR, view

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.integrity import SweptView
from mast_zenoh.pipelines import FreeSpaceVeto, MissionEstimator, PictureFirst


def cars(*places: tuple[float, float]) -> ObjectStates:
    return ObjectStates.of(np.array([[x, y, 0.75] for x, y in places]), size=np.tile(CAR, (len(places), 1)))


def test_objects_of_the_picture_in_own_free_space_are_left_out() -> None:
    veto = FreeSpaceVeto(mission=PictureFirst())
    picture, own = cars((20.0, 0.0), (0.0, 20.0), (0.0, 90.0)), cars((-20.0, 0.0))
    veto.look(view((0.0, 0.0), (20.0, 0.0, 2.0)))
    kept = veto.estimate(0, own, picture).position[:, :2].tolist()
    assert kept == [[20, 0], [0, 90], [-20, 0]], "the second is seen through, the third is far away"


def test_own_tracks_are_never_left_out() -> None:
    veto = FreeSpaceVeto(mission=PictureFirst())
    veto.look(view((0.0, 0.0)))
    assert veto.estimate(0, cars((20.0, 0.0)), cars()).position[:, 0].tolist() == [20]


def test_a_view_counts_for_one_estimate() -> None:
    veto, picture = FreeSpaceVeto(mission=PictureFirst()), cars((20.0, 0.0))
    assert len(veto.estimate(0, cars(), picture)) == 1, "there is no view"
    veto.look(view((0.0, 0.0)))
    assert len(veto.estimate(0, cars(), picture)) == 0
    assert len(veto.estimate(0, cars(), picture)) == 1, "the view was of the frame before"


def test_the_estimator_inside_gets_the_view_too() -> None:
    class Looking(PictureFirst):
        seen: SweptView | None = None

        def look(self, view: SweptView) -> None:
            self.seen = view

    inner = Looking()
    outer: MissionEstimator = FreeSpaceVeto(mission=inner)
    outer.look(view((0.0, 0.0)))
    assert inner.seen is not None
