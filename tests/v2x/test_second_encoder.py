"""Random CPM and CAM: asn1tools makes the same bytes and reads the same values."""

from __future__ import annotations

import asn1_oracle
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from plain_values import from_plain
from v2x_messages import MessageMaker

from mast_zenoh.v2x.asn1 import cam_fields, cpm_fields
from mast_zenoh.v2x.asn1.plain import to_plain
from mast_zenoh.v2x.asn1.uper import decode, encode

pytestmark = pytest.mark.skipif(not asn1_oracle.FOLDER.is_dir(), reason="no ASN.1 modules in $MAST_DATA/etsi_asn1")


@pytest.mark.parametrize("layout", [cpm_fields.LAYOUT, cam_fields.LAYOUT], ids=["CPM", "CAM"])
@settings(max_examples=25)
@given(st.integers(0, 2**32), st.sampled_from([0.1, 0.5, 0.9]))
def test_random_messages_have_the_bytes_and_values_of_asn1tools(layout, seed, presence):
    plain = MessageMaker(np.random.default_rng(seed), presence, beyond=False).draw(layout.type)
    data = encode(layout, from_plain(layout, plain))
    assert to_plain(layout, decode(layout, data)) == plain
    assert asn1_oracle.encode(layout.name, layout.type, plain) == data
    assert asn1_oracle.decode(layout.name, layout.type, data) == plain
