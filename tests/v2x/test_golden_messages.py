"""CPM and CAM that other implementations of the standards have encoded, recorded and with asn1tools."""

import json
import os
from pathlib import Path

import asn1_oracle
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plain_values import from_plain
from v2x_messages import MessageMaker

from mast_zenoh.v2x import cam, cpm
from mast_zenoh.v2x.asn1.uper import decode, encode, to_plain

FOLDER = Path(os.environ.get("MAST_DATA") or Path(__file__).parents[3] / "shared" / "data") / "etsi_asn1"
LAYOUTS = {"cpm": cpm.LAYOUT, "cam": cam.LAYOUT}
GOLDEN = {
    golden["name"]: golden
    for name in LAYOUTS
    if (file := FOLDER / f"{name}_golden.json").is_file()
    for golden in json.loads(file.read_text())
}
needs_golden = pytest.mark.skipif(not GOLDEN, reason="no golden messages in $MAST_DATA/etsi_asn1")


@needs_golden
def test_there_are_golden_messages_of_both_kinds():
    assert {name[:3] for name in GOLDEN} == LAYOUTS.keys()
    assert len(GOLDEN) == 45


@needs_golden
@pytest.mark.parametrize("name", GOLDEN)
def test_a_golden_message_has_the_same_fields_and_bytes(name):
    layout, fields, data = LAYOUTS[name[:3]], GOLDEN[name]["fields"], bytes.fromhex(GOLDEN[name]["uper"])
    assert to_plain(layout, decode(layout, data)) == fields
    assert encode(layout, from_plain(layout, fields)) == data
    assert encode(layout, decode(layout, data)) == data


pytestmark = pytest.mark.skipif(not asn1_oracle.FOLDER.is_dir(), reason="no ASN.1 modules in $MAST_DATA/etsi_asn1")


@pytest.mark.parametrize("layout", [cpm.LAYOUT, cam.LAYOUT], ids=["CPM", "CAM"])
@given(st.integers(0, 2**32), st.sampled_from([0.1, 0.5, 0.9]))
def test_random_messages_have_the_bytes_and_values_of_asn1tools(layout, seed, presence):
    plain = MessageMaker(np.random.default_rng(seed), presence, beyond=False).draw(layout.type)
    data = encode(layout, from_plain(layout, plain))
    assert to_plain(layout, decode(layout, data)) == plain
    assert asn1_oracle.encode(layout.name, layout.type, plain) == data
    assert asn1_oracle.decode(layout.name, layout.type, data) == plain
