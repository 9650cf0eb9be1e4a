"""Checks for user-written classes (docs/how-to-write-a-part.md).

A failed check raises AssertionError, which says what is wrong.

samples     objects, detections and estimates of any number
comparison  equal values, unchanged inputs
algorithms  check_tracker, check_clusterer, check_fusion, check_pipeline, check_mission_estimator, check_integrity,
            check_attack, check_metric
environment check_scene, check_detector, check_link_rule, check_fault; check_driver
scenarios   check_node, check_scenario
simulation  a mesh without processes, in virtual time: whole runs, disturbed at random
fixtures    for pytest: play
"""

from mast_zenoh.testing.algorithms import (
    check_attack,
    check_clusterer,
    check_fusion,
    check_integrity,
    check_metric,
    check_mission_estimator,
    check_pipeline,
    check_tracker,
)
from mast_zenoh.testing.environment import check_detector, check_driver, check_fault, check_link_rule, check_scene
from mast_zenoh.testing.scenarios import check_node, check_scenario

__all__ = [
    "check_attack",
    "check_clusterer",
    "check_detector",
    "check_driver",
    "check_fault",
    "check_fusion",
    "check_integrity",
    "check_link_rule",
    "check_metric",
    "check_mission_estimator",
    "check_node",
    "check_pipeline",
    "check_scenario",
    "check_scene",
    "check_tracker",
]
