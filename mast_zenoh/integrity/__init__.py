"""Integrity: judges the agents' tracks before they are fused.

base       what a stage gets and returns; STATES of agents
views      what the agents' sensors cover
visibility who should see an object, and who sees through it


"""

from mast_zenoh.integrity.base import (
    STATES,
    AgentTrust,
    Assessment,
    Batch,
    Integrity,
    NoIntegrity,
    ObjectTrust,
    trust_columns,
)
from mast_zenoh.integrity.views import SweptView
from mast_zenoh.integrity.visibility import Sightings, sightings

__all__ = [
    "STATES",
    "AgentTrust",
    "Assessment",
    "Batch",
    "Integrity",
    "NoIntegrity",
    "ObjectTrust",
    "Sightings",
    "SweptView",
    "sightings",
    "trust_columns",
]
