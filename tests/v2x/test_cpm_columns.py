"""CPM and CAM as integers in the standard's units."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plain_values import from_plain
from v2x_messages import MessageMaker

from mast_zenoh.errors import MessageError
from mast_zenoh.v2x import cam, cpm
from mast_zenoh.v2x.asn1 import cam_fields, cpm_fields, uper
from mast_zenoh.v2x.asn1.cdd import PerceivedObject
from mast_zenoh.v2x.asn1.layout import slot_of
from mast_zenoh.v2x.asn1.plain import to_plain
from mast_zenoh.v2x.perceived_objects import ABSENT, CARTESIAN, OTHER, PEDESTRIAN, VEHICLE, VRU, PerceivedObjects
from mast_zenoh.v2x.reference_position import Position


def two_objects() -> PerceivedObjects:
    """A car with all columns, and a pedestrian with the mandatory ones."""
    objects = PerceivedObjects.empty(2)
    objects.id[:], objects.delta_time[:] = [7, 65535], [-40, 0]
    objects.position[:, :2], objects.position_confidence[:, :2] = [[1000, -2000], [131070, 5]], 30
    objects.table[0, 2:] = np.where(objects.table[0, 2:] == ABSENT, 1, objects.table[0, 2:])
    classes = np.array([[0, VEHICLE, ABSENT, 5, 90], [0, OTHER, ABSENT, 1, 10], [1, VRU, PEDESTRIAN, 1, 101]])
    matrices = [[0, 0, 0, 1, -100], [0, 1, 0, 3, 50], [0, 1, 0, 12, 7], [0, 1, 3, 12, 101], [1, 0, 0, 1, 0]]
    return dataclasses.replace(
        objects, classes=classes, sensors=np.array([[0, 3], [0, 4]]), correlations=np.array(matrices)
    )


def message(**fields) -> cpm.Cpm:
    return cpm.Cpm(4711, 690_000_000_000, Position(520_000_000, 94_000_000), **fields)


def test_columns_have_the_fields_of_the_standard():
    values = cpm.to_values(message(objects=two_objects()))
    (container,) = to_plain(cpm_fields.LAYOUT, values)["payload"]["cpmContainers"]
    car, pedestrian = container["containerData"]["perceivedObjects"]
    assert pedestrian == {
        "objectId": 65535,
        "measurementDeltaTime": 0,
        "position": {"xCoordinate": {"value": 131070, "confidence": 30}, "yCoordinate": {"value": 5, "confidence": 30}},
        "lowerTriangularCorrelationMatrices": [{"componentsIncludedIntheMatrix": "1100000000000", "matrix": [[0]]}],
        "classification": [{"objectClass": {"vruSubClass": {"pedestrian": 1}}, "confidence": 101}],
    }
    assert car["lowerTriangularCorrelationMatrices"] == [
        {"componentsIncludedIntheMatrix": "1100000000000", "matrix": [[-100]]},
        {"componentsIncludedIntheMatrix": "1001000000001", "matrix": [[50, 7], [101]]},
    ]
    assert car["velocity"].keys() == {"cartesianVelocity"}
    assert car["sensorIdList"] == [3, 4]
    assert [list(entry["objectClass"]) for entry in car["classification"]] == [["vehicleSubClass"], ["otherSubClass"]]


@settings(max_examples=60)
@given(st.integers(0, 2**32), st.sampled_from([0.1, 0.5, 0.9]), st.booleans())
def test_random_messages_say_what_the_columns_do_not_hold(seed, presence, beyond):
    """A message of which everything was read encodes to the same fields."""
    layout, random = cpm_fields.LAYOUT, np.random.default_rng(seed)
    plain = MessageMaker(random, presence, beyond).draw(layout.type)
    containers = plain["payload"]["cpmContainers"]
    ids = [container["containerId"] for container in containers]
    data = uper.encode(layout, from_plain(layout, plain))
    if len(set(ids)) < len(ids):
        with pytest.raises(MessageError, match="found two containers with identifier"):
            cpm.decode(data)
        return
    received = cpm.decode(data)
    if not received.unread:
        containers.sort(key=lambda container: container["containerId"])
        assert to_plain(layout, cpm.to_values(received)) == plain


RATE = {"mantissa": 1, "exponent": 0}


@pytest.mark.parametrize(
    ("extra", "name"),
    [({"messageRateRange": {"messageRateMin": RATE, "messageRateMax": RATE}}, "messageRateRange"), ({"+0": "00"}, "+")],
)
def test_fields_without_a_column_are_named(extra, name):
    plain = to_plain(cpm_fields.LAYOUT, cpm.to_values(message(rsu=True)))
    plain["payload"]["managementContainer"] |= extra
    assert cpm.decode(uper.encode(cpm_fields.LAYOUT, from_plain(cpm_fields.LAYOUT, plain))).unread == {name}


def test_values_outside_the_standard_are_refused_with_the_path_of_the_field():
    objects = two_objects()
    objects.position[1, 0] = 131072
    with pytest.raises(MessageError, match=r"perceivedObjects\[1\].position.xCoordinate.value: found 131072, expected"):
        cpm.encode(message(objects=objects))
    objects = two_objects()
    objects.velocity[1] = 5
    with pytest.raises(MessageError, match=r"perceivedObjects\[1\].velocity.* found a value, but its field is absent"):
        cpm.encode(message(objects=objects))
    objects.velocity_form[1] = CARTESIAN
    with pytest.raises(MessageError, match=r"perceivedObjects\[1\].velocity.* found"):
        cpm.encode(message(objects=objects))
    owner, sound = np.array([1, 0, 0, 0, 0]), two_objects().classes
    for classes in (sound[::-1], sound + owner, sound - owner):
        with pytest.raises(MessageError, match="lists in another order than their objects"):
            cpm.encode(message(objects=dataclasses.replace(two_objects(), classes=classes)))


@pytest.mark.parametrize("name", ["velocity", "acceleration"])
def test_polar_vectors_have_the_columns_of_cartesian_ones(name):
    axis = name.capitalize()
    cartesian = [f"x{axis}.value", f"y{axis}.value", f"y{axis}.confidence", f"z{axis}?", f"z{axis}.confidence"]
    magnitude = "velocityMagnitude.speedValue" if name == "velocity" else f"{name}Magnitude.{name}MagnitudeValue"
    polar = [magnitude, f"{name}Direction.value", f"{name}Direction.confidence", f"z{axis}?", f"z{axis}.confidence"]
    for one, other in zip(cartesian, polar, strict=True):
        places = (f"{name}.cartesian{axis}.{one}", f"{name}.polar{axis}.{other}")
        assert len({slot_of(PerceivedObject, place) for place in places}) == 1


@pytest.mark.parametrize(
    ("cells", "expected"),
    [
        ([[0, 1, 0, 1, 0]], "found correlation matrix 1, expected ascending numbers"),
        ([[2, 0, 0, 1, 0]], "found correlation matrix 0, expected ascending numbers"),
        ([[0, 0, 0, 1, 0], [0, 0, 0, 2, 0]], "found other pairs than all of its components"),
        ([[0, 0, 1, 0, 0]], "found other pairs than all of its components"),
        ([[0, 0, 0, 13, 0]], "found other pairs than all of its components"),
        ([[0, 0, 0, 1, 102]], r"Matrices\[0\].matrix\[0\]\[0\]: found 102, expected -100..101"),
    ],
)
def test_correlations_that_are_no_matrix_are_refused(cells, expected):
    objects = dataclasses.replace(two_objects(), correlations=np.array(cells))
    with pytest.raises(MessageError, match=expected):
        cpm.encode(message(objects=objects))


@pytest.mark.parametrize("matrix", [[[1]], [[1, 2], [3, 4]], [[1, 2], [3], [4]]])
def test_received_matrices_of_another_shape_than_their_components_say_are_named(matrix):
    layout = cpm_fields.LAYOUT
    plain = to_plain(layout, cpm.to_values(message(objects=two_objects())))
    car, _ = plain["payload"]["cpmContainers"][0]["containerData"]["perceivedObjects"]
    car["lowerTriangularCorrelationMatrices"][1]["matrix"] = matrix
    received = cpm.decode(uper.encode(layout, from_plain(layout, plain)))
    assert received.unread == {"lowerTriangularCorrelationMatrices"}
    assert received.objects.correlations.tolist() == [[0, 0, 0, 1, -100], [1, 0, 0, 1, 0]]


def test_some_objects_are_taken_with_their_lists():
    taken = two_objects().take(np.array([1]))
    assert taken.id.tolist() == [65535]
    assert taken.classes.tolist() == [[0, VRU, PEDESTRIAN, 1, 101]]
    assert len(taken.sensors) == 0
    assert taken.correlations.tolist() == [[0, 0, 0, 1, 0]]


MESSAGE = cam.Cam(4711, 12345, 5, Position(520_000_000, 94_000_000))


@settings(max_examples=60)
@given(st.integers(0, 2**32), st.sampled_from([0.0, 0.1, 0.5]), st.booleans())
def test_random_messages_say_what_has_no_place(seed, presence, beyond):
    """A message of which everything was read encodes to the same bytes."""
    layout = cam_fields.LAYOUT
    plain = MessageMaker(np.random.default_rng(seed), presence, beyond).draw(layout.type)
    data = uper.encode(layout, from_plain(layout, plain))
    received = cam.decode(data)
    if not received.unread:
        assert cam.encode(received) == data


def test_lights_are_bits_from_the_first_to_the_last():
    status = cam.VehicleStatus(lights=0b10000001)
    plain = to_plain(cam_fields.LAYOUT, cam.to_values(dataclasses.replace(MESSAGE, status=status)))
    low = plain["cam"]["camParameters"]["lowFrequencyContainer"]["basicVehicleContainerLowFrequency"]
    assert low == {"vehicleRole": "default", "exteriorLights": "10000001", "pathHistory": []}


def test_values_of_a_cam_outside_the_standard_are_refused_with_the_path_of_the_field():
    with pytest.raises(MessageError, match=r"speed.speedValue: found 16384, expected 0..16383"):
        cam.encode(dataclasses.replace(MESSAGE, vehicle=cam.VehicleMotion(speed=16384)))
    with pytest.raises(MessageError, match=r"pathHistory: found 24 elements, expected 0..23"):
        cam.encode(dataclasses.replace(MESSAGE, status=cam.VehicleStatus(path=np.zeros((24, 4), np.int64))))
