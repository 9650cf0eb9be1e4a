"""Checks for user-written classes (docs/extending.md).

A failed check raises AssertionError, which says what is wrong.

samples     objects, detections and estimates of any number
comparison  equal values, unchanged inputs
perception  check_tracker, check_clusterer, check_fusion
attacks     check_attack
measures    check_metric
network     check_link_rule, check_fault
scenarios   check_node, check_scenario
fixtures    for pytest: play
"""

from mast_zenoh.testing.attacks import check_attack
from mast_zenoh.testing.measures import check_metric
from mast_zenoh.testing.network import check_fault, check_link_rule
from mast_zenoh.testing.perception import check_clusterer, check_fusion, check_tracker
from mast_zenoh.testing.scenarios import check_node, check_scenario

__all__ = [
    "check_attack",
    "check_clusterer",
    "check_fault",
    "check_fusion",
    "check_link_rule",
    "check_metric",
    "check_node",
    "check_scenario",
    "check_tracker",
]
