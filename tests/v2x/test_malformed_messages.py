"""Damaged CPM and CAM are refused with the field's path, or are other canonical messages."""

import numpy as np
import pytest
from fuzzing import Fuzzing
from plain_values import from_plain
from uper_oracle import decode_values
from v2x_messages import MessageMaker, damaged

from mast_zenoh import kernels
from mast_zenoh.errors import MessageError
from mast_zenoh.v2x import cam, cpm
from mast_zenoh.v2x.asn1.layout import EncodingProgram
from mast_zenoh.v2x.asn1.uper import decode, encode, to_plain

LAYOUTS = [cpm.LAYOUT, cam.LAYOUT]
of_both = pytest.mark.parametrize("layout", LAYOUTS, ids=["CPM", "CAM"])


def messages(layout, random, n):
    """Bytes of n random messages, also with what is beyond the root of extensible types."""
    for _ in range(n):
        maker = MessageMaker(random, random.choice([0.1, 0.5, 0.9]), beyond=bool(random.integers(2)))
        yield encode(layout, from_plain(layout, maker.draw(layout.type)))


def refused_or_canonical(layout, data):
    """Whether damaged bytes are refused; if they are not, they encode to the same bytes again."""
    try:
        values = decode(layout, data)
    except MessageError:
        return True
    assert encode(layout, values) == data
    assert encode(layout, from_plain(layout, to_plain(layout, values))) == data
    return False


@of_both
def test_random_messages_survive_in_values_and_plain(layout):
    for data in messages(layout, np.random.default_rng(1), 200):
        assert not refused_or_canonical(layout, data)


def play_damages(layout, n, seed):
    random = np.random.default_rng(seed)
    originals = [data for data in messages(layout, random, 200) if len(data) < 2000]
    refused = [
        refused_or_canonical(layout, damaged(random, originals[random.integers(len(originals))])) for _ in range(n)
    ]
    assert 0.3 * n < sum(refused) < n


@of_both
def test_no_damaged_message_crashes_or_passes_silently(layout):
    play_damages(layout, 1500, 2)


@pytest.mark.heavy
@of_both
def test_no_damaged_message_of_many_crashes_or_passes_silently(layout, fuzzing: Fuzzing):
    play_damages(layout, fuzzing.draws(10_000, 50_000), 3)


@pytest.mark.skipif(not kernels.COMPILED, reason="no kernels were compiled here (no C compiler?)")
@of_both
def test_compiled_kernels_and_the_oracle_refuse_damaged_messages_for_the_same_reason(layout):
    random = np.random.default_rng(5)
    for data in messages(layout, random, 150):
        received = damaged(random, data)
        values, refusal = kernels.COMPILED["decode_values"](layout.program, received)
        expected, reason = decode_values(layout.program, received)
        assert refusal == reason
        np.testing.assert_array_equal(values, expected)


@of_both
def test_a_message_that_ends_early_is_refused_at_every_length(layout):
    data = next(data for data in messages(layout, np.random.default_rng(4), 99) if 60 < len(data) < 300)
    for n in range(len(data)):
        assert refused_or_canonical(layout, data[:n])
    with pytest.raises(MessageError, match=r"message.*2 trailing"):
        decode(layout, data + b"\x00\x00")


def test_a_forged_count_is_refused_before_any_element_is_read():
    layout = EncodingProgram("list of regions", cpm.PerceptionRegionContainer)
    count_of_16383 = int("1" + "10" + 14 * "1" + 7 * "0", 2).to_bytes(3)
    with pytest.raises(MessageError, match=r"message.*bytes.*needed"):
        decode(layout, count_of_16383 + bytes(50))
