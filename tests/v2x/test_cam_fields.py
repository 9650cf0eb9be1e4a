"""CAM as integers in the standard's units."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plain_values import from_plain
from v2x_messages import MessageMaker

from mast_zenoh.errors import MessageError
from mast_zenoh.v2x import cam
from mast_zenoh.v2x.asn1 import cam_fields, uper
from mast_zenoh.v2x.asn1.plain import to_plain
from mast_zenoh.v2x.reference_position import Position

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


def test_values_outside_the_standard_are_refused_with_the_path_of_the_field():
    with pytest.raises(MessageError, match=r"speed.speedValue: found 16384, expected 0..16383"):
        cam.encode(dataclasses.replace(MESSAGE, vehicle=cam.VehicleMotion(speed=16384)))
    with pytest.raises(MessageError, match=r"pathHistory: found 24 elements, expected 0..23"):
        cam.encode(dataclasses.replace(MESSAGE, status=cam.VehicleStatus(path=np.zeros((24, 4), np.int64))))
