"""Configurations of SUMO that people have: riders of a bus, ballistic steps."""

from __future__ import annotations

import os
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from mast_datasets import SumoTraffic
from mast_datasets.sumo_simulation import read_configuration

from mast_zenoh.arrays.states import CLASS_INDEX

CASES = Path(os.environ.get("MAST_DATA") or Path(__file__).parents[4] / "shared" / "data") / "field_cases"
pytestmark = pytest.mark.skipif(not CASES.is_dir(), reason="no inputs in $MAST_DATA/field_cases")
needs_sumo = pytest.mark.skipif(find_spec("libsumo") is None, reason="SUMO is not installed")


@pytest.mark.heavy
@needs_sumo
def test_riders_of_a_stepped_bus_are_no_pedestrians() -> None:
    path = str(CASES / "sumo_bus_riders" / "t.sumocfg")
    scene = SumoTraffic(path=path, n_infrastructure=0, start_s=20.0, radius_m=1000.0).record(0, 20)
    people = scene.truth.class_id == CLASS_INDEX["pedestrian"]
    assert np.hypot(*scene.truth.velocity[people, :2].T).max(initial=0.0) < 3.0
    assert (scene.truth.class_id == CLASS_INDEX["bus"]).any()


@pytest.mark.heavy
@needs_sumo
def test_ballistic_steps_are_driven() -> None:
    path = CASES / "sumo_sublanes" / "ballistic.sumocfg"
    assert read_configuration(path).options["step-method.ballistic"] == "true"
    scene = SumoTraffic(path=str(path), n_infrastructure=0, start_s=60.0, radius_m=1000.0).record(0, 20)
    assert np.hypot(*scene.truth.velocity[:, :2].T).max() > 5.0
