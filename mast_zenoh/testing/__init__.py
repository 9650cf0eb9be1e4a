"""Checks for user-written classes (docs/extending.md).

A failed check raises AssertionError, which says what is wrong.

samples     objects, detections and estimates of any number
comparison  equal values, unchanged inputs
scenes      check_scene, check_detector
perception  check_tracker, check_clusterer, check_fusion
pipelines   check_pipeline, check_mission_estimator
integrity   check_integrity
attacks     check_attack
measures    check_metric
network     check_link_rule, check_fault
scenarios   check_node, check_scenario
simulation  a mesh without processes, in virtual time: whole runs, disturbed at random
fixtures    for pytest: play
"""

from mast_zenoh.testing.attacks import check_attack
from mast_zenoh.testing.integrity import check_integrity
from mast_zenoh.testing.measures import check_metric
from mast_zenoh.testing.network import check_fault, check_link_rule
from mast_zenoh.testing.perception import check_clusterer, check_fusion, check_tracker
from mast_zenoh.testing.pipelines import check_mission_estimator, check_pipeline
from mast_zenoh.testing.scenarios import check_node, check_scenario
from mast_zenoh.testing.scenes import check_detector, check_scene

__all__ = [
    "check_attack",
    "check_clusterer",
    "check_detector",
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
