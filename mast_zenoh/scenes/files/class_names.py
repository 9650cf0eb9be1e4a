"""Our classes of objects, by the names that data sets and detectors use."""

from __future__ import annotations

from mast_zenoh.arrays.states import CLASS_INDEX

_CLASSES = {
    "van": "car",
    "walker": "pedestrian",
    "person": "pedestrian",
    "cyclist": "bicycle",
    "bike": "bicycle",
    "motorbike": "motorcycle",
}


def class_of(name: str) -> int:
    """The index into CLASSES of a type name; 0 (unknown) for other names."""
    return CLASS_INDEX.get(_CLASSES.get(name.lower(), name.lower()), 0)
