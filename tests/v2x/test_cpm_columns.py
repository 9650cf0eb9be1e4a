"""CPM and CAM as integers in the standard's units."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plain_values import from_plain
from v2x_messages import MessageMaker

from mast_zenoh.errors import MessageError
from mast_zenoh.v2x import cam, cpm
from mast_zenoh.v2x.asn1 import uper
from mast_zenoh.v2x.asn1.asn1_types import Optional
from mast_zenoh.v2x.asn1.cdd import PerceivedObject
from mast_zenoh.v2x.asn1.layout import slot_of
from mast_zenoh.v2x.asn1.uper import to_plain
from mast_zenoh.v2x.perceived_objects import ABSENT, CARTESIAN, OTHER, PEDESTRIAN, VEHICLE, VRU, PerceivedObjects
from mast_zenoh.v2x.reference_position import Position


def two_objects() -> PerceivedObjects:
    """A car with all columns, and a pedestrian with the mandatory ones."""
    objects = PerceivedObjects.empty(2)
    objects.id[:], objects.delta_time[:] = [7, 65535], [-40, 0]
    objects.position[:, :2], objects.position_confidence[:, :2] = [[1000, -2000], [131070, 5]], 30
    objects.table[0, 2:] = np.where(objects.table[0, 2:] == ABSENT, 1, objects.table[0, 2:])
    classes = np.array([[0, VEHICLE, ABSENT, 5, 90], [0, OTHER, ABSENT, 1, 10], [1, VRU, PEDESTRIAN, 1, 101]])
    return dataclasses.replace(objects, classes=classes)


def message(**fields) -> cpm.Cpm:
    return cpm.Cpm(4711, 690_000_000_000, Position(520_000_000, 94_000_000), **fields)


def test_columns_have_the_fields_of_the_standard():
    values = cpm.to_values(message(objects=two_objects()))
    (container,) = to_plain(cpm.LAYOUT, values)["payload"]["cpmContainers"]
    car, pedestrian = container["containerData"]["perceivedObjects"]
    assert pedestrian == {
        "objectId": 65535,
        "measurementDeltaTime": 0,
        "position": {"xCoordinate": {"value": 131070, "confidence": 30}, "yCoordinate": {"value": 5, "confidence": 30}},
        "classification": [{"objectClass": {"vruSubClass": {"pedestrian": 1}}, "confidence": 101}],
    }
    assert car["velocity"].keys() == {"cartesianVelocity"}
    assert [list(entry["objectClass"]) for entry in car["classification"]] == [["vehicleSubClass"], ["otherSubClass"]]


#: Fields of a CPM that its columns hold, of each container and of each object.
HELD = {
    cpm.VEHICLE: {"orientationAngle"},
    cpm.RSU: set(),
    cpm.OBJECTS: {"numberOfPerceivedObjects", "perceivedObjects"},
}
HELD_OF_OBJECTS = {
    "objectId", "measurementDeltaTime", "position", "velocity", "angles", "objectDimensionX", "objectDimensionY",
    "objectDimensionZ", "objectPerceptionQuality", "classification",
}  # fmt: skip


def keep(plain: dict, names: set[str]) -> None:
    """Remove all other fields."""
    for name in plain.keys() - names:
        del plain[name]


def keep_what_columns_hold(plain: dict) -> None:
    """Remove the other fields of a random CPM."""
    payload = plain["payload"]
    keep(payload, {"managementContainer", "cpmContainers"})
    keep(payload["managementContainer"], {"referenceTime", "referencePosition", "segmentationInfo"})
    containers = [container for container in payload["cpmContainers"] if container["containerId"] in HELD]
    payload["cpmContainers"] = sorted(containers, key=lambda container: container["containerId"])
    for container in containers:
        keep(container["containerData"], HELD[container["containerId"]])
        for perceived in container["containerData"].get("perceivedObjects", []):
            keep(perceived, HELD_OF_OBJECTS)
            keep(perceived.get("angles", {}), {"zAngle"})


def is_held(object_class: dict) -> bool:
    """Whether the columns hold all of a class: it is neither a group nor of a later version."""
    ((kind, subclass),) = object_class.items()
    later = kind.startswith("+") or (kind == "vruSubClass" and next(iter(subclass)).startswith("+"))
    return kind != "groupSubClass" and not later


def remove_other_classes(plain: dict) -> None:
    """Remove the classes of a random CPM that its columns do not hold."""
    for container in plain["payload"]["cpmContainers"]:
        if container["containerId"] == cpm.OBJECTS:
            for perceived in container["containerData"]["perceivedObjects"]:
                classes = perceived.pop("classification", [])
                if held := [entry for entry in classes if is_held(entry["objectClass"])]:
                    perceived["classification"] = held


@given(st.integers(0, 2**32), st.sampled_from([0.1, 0.5, 0.9]), st.booleans())
def test_columns_hold_their_fields_of_any_message(seed, presence, beyond):
    layout, random = cpm.LAYOUT, np.random.default_rng(seed)
    plain = MessageMaker(random, presence, beyond).draw(layout.type)
    remove_other_classes(plain)
    ids = [container["containerId"] for container in plain["payload"]["cpmContainers"]]
    data = uper.encode(layout, from_plain(layout, plain))
    if len(set(ids)) < len(ids):
        with pytest.raises(MessageError, match=r"two containers.*identifier"):
            cpm.decode(data)
        return
    keep_what_columns_hold(plain)
    assert to_plain(layout, cpm.to_values(cpm.decode(data))) == plain


def test_values_outside_the_standard_are_refused_with_the_path_of_the_field():
    objects = two_objects()
    objects.position[1, 0] = 131072
    with pytest.raises(MessageError, match=r"perceivedObjects\[1\].position.xCoordinate.value.*131072"):
        cpm.encode(message(objects=objects))
    objects = two_objects()
    objects.velocity_form[1] = CARTESIAN
    with pytest.raises(MessageError, match=r"perceivedObjects\[1\].velocity.* found"):
        cpm.encode(message(objects=objects))


@pytest.mark.parametrize(
    ("cartesian", "polar"),
    [
        ("xVelocity.value", "velocityMagnitude.speedValue"),
        ("yVelocity.value", "velocityDirection.value"),
        ("yVelocity.confidence", "velocityDirection.confidence"),
        ("zVelocity?", "zVelocity?"),
        ("zVelocity.confidence", "zVelocity.confidence"),
    ],
)
def test_polar_velocities_have_the_columns_of_cartesian_ones(cartesian, polar):
    place = slot_of(PerceivedObject, f"velocity.cartesianVelocity.{cartesian}")
    assert place == slot_of(PerceivedObject, f"velocity.polarVelocity.{polar}")


def test_some_objects_are_taken_with_their_classes():
    taken = two_objects().take(np.array([1]))
    assert taken.id.tolist() == [65535]
    assert taken.classes.tolist() == [[0, VRU, PEDESTRIAN, 1, 101]]


MESSAGE = cam.Cam(4711, 12345, 5, Position(520_000_000, 94_000_000))


@given(st.integers(0, 2**32), st.sampled_from([0.0, 0.1, 0.5]), st.booleans())
def test_a_cam_holds_its_fields_of_any_message(seed, presence, beyond):
    layout = cam.LAYOUT
    plain = MessageMaker(np.random.default_rng(seed), presence, beyond).draw(layout.type)
    received = cam.decode(uper.encode(layout, from_plain(layout, plain)))
    parameters = plain["cam"]["camParameters"]
    keep(parameters, {"basicContainer", "highFrequencyContainer"})
    keep(parameters["basicContainer"], {"stationType", "referencePosition"})
    ((station, container),) = parameters["highFrequencyContainer"].items()
    if station == "basicVehicleContainerHighFrequency":
        fields = cam.BasicVehicleContainerHighFrequency.fields
        keep(container, {name for name, type in fields.items() if not isinstance(type, Optional)})
    else:
        parameters["highFrequencyContainer"] = {"rsuContainerHighFrequency": {}}
    assert to_plain(layout, cam.to_values(received)) == plain


def test_values_of_a_cam_outside_the_standard_are_refused_with_the_path_of_the_field():
    with pytest.raises(MessageError, match=r"speed.speedValue.*16384.*0..16383"):
        cam.encode(dataclasses.replace(MESSAGE, vehicle=cam.VehicleMotion(speed=16384)))
