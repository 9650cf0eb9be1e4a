"""Keys, tokens, quality of service and attachments are those of other libraries, and survive a round trip."""

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mast_ros2 import type_store
from mast_ros2.attachments import GID_BYTES, MessageAttachment, parse_attachment
from mast_ros2.liveliness_tokens import (
    ENDPOINTS,
    NO_HASH,
    DataKey,
    EndpointToken,
    NodeToken,
    Qos,
    all_tokens,
    check_topic,
    dds_type,
    demangle,
    mangle,
    parse_token,
)
from ros2_keys import parse_data_key
from ros2_messages import CONVERTED

from mast_zenoh.errors import MessageError

STRING = "std_msgs/msg/String"
STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"

#: In the form of rmw_zenoh's design document.
NODE = "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/listener"
PUBLISHER = (
    "@ros2_lv/2/8b20917502ee955ac4476e0266340d5c/0/10/MP/%/%/talker/%chatter/"
    f"std_msgs::msg::dds_::String_/{STRING_HASH}/::,7:,:,:,,"
)
SUBSCRIPTION = (
    "@ros2_lv/0/a1/3/11/MS/%/%fleet%car_1/viewer/%fleet%car_1%chatter/"
    f"std_msgs::msg::dds_::String_/{NO_HASH}/2:1:2,10:1,5:,:3,0,7"
)
TOKENS = (NODE, PUBLISHER, SUBSCRIPTION)

few = settings(max_examples=25)

names = st.from_regex(r"[A-Za-z_][A-Za-z0-9_]{0,12}", fullmatch=True)
topics = st.lists(names, min_size=1, max_size=4).map(lambda chunks: "/" + "/".join(chunks))
namespaces = st.just("/") | topics
types = st.tuples(
    st.from_regex(r"[a-z][a-z0-9_]{0,8}", fullmatch=True),
    st.sampled_from(["msg", "srv", "action"]),
    st.from_regex(r"[A-Z][A-Za-z0-9]{0,8}", fullmatch=True),
).map("/".join)
hashes = st.none() | st.from_regex(r"RIHS01_[0-9a-f]{64}", fullmatch=True)
domains, numbers = st.integers(0, 2**32 - 1), st.integers(0, 2**62)
qualities = st.builds(Qos, st.booleans(), st.integers(1, 100)).map(Qos.write)
sessions = st.from_regex(r"[0-9a-f]{1,32}", fullmatch=True)
nodes = st.builds(NodeToken, domains, sessions, numbers, names, namespaces, namespaces)
endpoints = st.builds(EndpointToken, nodes, numbers, st.sampled_from([*ENDPOINTS]), topics, types, hashes, qualities)


@pytest.fixture(scope="module")
def pamoja() -> Any:
    """Names and keys by pamoja-ros2."""
    return pytest.importorskip("pamoja.ros2", reason="pamoja-ros2 is not installed", exc_type=ImportError)


@pytest.fixture(scope="module")
def sdk() -> Any:
    """Keys, tokens and attachments by zenoh-ros2-sdk."""
    return pytest.importorskip("zenoh_ros2_sdk", reason="zenoh-ros2-sdk is not installed", exc_type=ImportError)


READ = {DataKey: parse_data_key, NodeToken: parse_token, EndpointToken: parse_token}
READ |= {MessageAttachment: parse_attachment}
signed = st.integers(-(2**63), 2**63 - 1)
keys = st.builds(DataKey, domains, topics, types, hashes) | endpoints.map(lambda token: token.data_key)
attachments = st.builds(MessageAttachment, signed, signed, st.binary(min_size=16, max_size=16))


@settings(max_examples=125)
@given(keys | nodes | endpoints | attachments)
def test_what_is_written_is_read_again(written: Any) -> None:
    assert READ[type(written)](written.write()) == written


@few
@given(domains, topics, types)
def test_data_keys_and_names_are_those_of_pamoja(pamoja: Any, domain: int, topic: str, type_name: str) -> None:
    if "__" in topic:
        return  # it refuses them: the design of topic names does, the checks of ROS do not
    assert pamoja.dds_type_name(type_name) == dds_type(type_name)
    assert pamoja.percent_mangle(topic) == mangle(topic)
    ours = DataKey(domain, topic, type_name, STRING_HASH).write()
    assert pamoja.entity_key(domain, topic, type_name, STRING_HASH) == ours


@pytest.mark.parametrize("type_name", CONVERTED)
def test_data_keys_of_all_types_are_those_of_pamoja_and_the_sdk(pamoja: Any, sdk: Any, type_name: str) -> None:
    ours = DataKey.of(3, "/a/b", type_name).write()
    type_hash = type_store.type_hash(type_name)
    assert pamoja.entity_key(3, "/a/b", type_name, type_hash) == ours
    assert bytes(pamoja.type_hash_digest(type_hash)).hex() == type_hash.removeprefix("RIHS01_")
    assert sdk.keyexpr.topic_keyexpr(3, "/a/b", sdk.utils.ros2_to_dds_type(type_name), type_hash) == ours


@few
@given(st.text(alphabet="aZ09_/% -é", max_size=12))
def test_a_topic_is_valid_where_pamoja_says_so(pamoja: Any, topic: str) -> None:
    if "__" in topic:
        return
    try:
        check_topic(topic)
    except ValueError:
        assert not pamoja.is_fully_qualified(topic)
    else:
        assert pamoja.is_fully_qualified(topic)


@few
@given(st.text(alphabet="a_0/", max_size=12))
def test_a_mangled_name_survives(name: str) -> None:
    assert demangle(mangle(name)) == name
    assert "/" not in mangle(name)


def test_tokens_of_the_design_document_are_read_and_written() -> None:
    assert [parse_token(token).write() for token in TOKENS] == list(TOKENS)
    assert parse_token(NODE) == NodeToken(2, "aac3178e146ba6f1fc6e6a4085e77f21", 0, "listener")
    talker = NodeToken(2, "8b20917502ee955ac4476e0266340d5c", 0, "talker")
    assert parse_token(PUBLISHER) == EndpointToken(
        talker, 10, "publisher", "/chatter", STRING, STRING_HASH, Qos(depth=7).write()
    )
    viewer = NodeToken(0, "a1", 3, "viewer", "/fleet/car_1")
    assert parse_token(SUBSCRIPTION) == EndpointToken(
        viewer, 11, "subscription", "/fleet/car_1/chatter", STRING, None, "2:1:2,10:1,5:,:3,0,7"
    )


@pytest.mark.parametrize("token", [PUBLISHER, SUBSCRIPTION, NODE])
def test_chunks_after_the_last_known_one_are_ignored(token: str) -> None:
    assert parse_token(f"{token}/cpu:1;cuda:2/more") == parse_token(token)


def test_services_and_clients_are_told_from_topics() -> None:
    for kind, code in (("service", "SS"), ("client", "SC")):
        token = PUBLISHER.replace("/MP/", f"/{code}/").replace("std_msgs::msg", "std_srvs::srv")
        endpoint = parse_token(token)
        assert isinstance(endpoint, EndpointToken)
        assert (endpoint.kind, endpoint.type_name) == (kind, "std_srvs/srv/String")


@few
@given(nodes)
def test_tokens_of_nodes_are_those_of_the_sdk(sdk: Any, node: NodeToken) -> None:
    theirs = sdk.entity.NodeEntity(
        node.domain, node.session, node.number, node.name, node.namespace, mangle(node.enclave)
    )
    assert sdk.keyexpr.node_liveliness_keyexpr(theirs) == node.write()


@few
@given(endpoints)
def test_tokens_of_endpoints_are_those_of_the_sdk_and_read_by_it(sdk: Any, token: EndpointToken) -> None:
    node = token.node
    theirs = sdk.entity.EndpointEntity(
        sdk.entity.NodeEntity(node.domain, node.session, node.number, node.name, node.namespace, mangle(node.enclave)),
        token.number,
        sdk.entity.EntityKind(ENDPOINTS[token.kind]),
        token.topic,
        dds_type(token.type_name),
        token.type_hash or NO_HASH,
        token.qos,
    )
    written = sdk.keyexpr.endpoint_liveliness_keyexpr(theirs)
    assert written == token.write()
    read = sdk.discovery._parse_liveliness_keyexpr(written)
    assert (read["domain_id"], read["qualified_name"]) == (node.domain, token.topic)
    assert sdk.utils.dds_to_ros_type(read["dds_type"]) == token.type_name


@pytest.mark.parametrize("depth", [1, 10, 100])
@pytest.mark.parametrize("durability", ["volatile", "transient_local"])
def test_quality_of_service_is_read_alike_by_the_sdk(sdk: Any, depth: int, durability: str) -> None:
    ours = Qos(durability == "transient_local", depth)
    theirs = sdk.qos.QosProfile(
        sdk.qos.QosReliability.RELIABLE, sdk.qos.QosDurability[durability.upper()], history_depth=depth
    )
    assert ours.write() == theirs.encode()
    assert sdk.qos.QosProfile.decode(ours.write()) == theirs


def test_an_empty_depth_is_rmw_zenohs_default() -> None:  # the SDK takes 10 for it
    assert Qos(depth=42).write() == "::,:,:,:,,"
    assert Qos().write() == "::,10:,:,:,,"


@few
@given(st.integers(0, 2**63 - 1), st.integers(0, 2**63 - 1), st.binary(min_size=16, max_size=16))
def test_an_attachment_has_the_bytes_of_the_sdk(sdk: Any, sequence: int, stamp_ns: int, gid: bytes) -> None:
    assert (
        sdk.attachment.Attachment(sequence, stamp_ns, gid).to_bytes()
        == MessageAttachment(sequence, stamp_ns, gid).write()
    )


def test_an_attachment_with_labels_is_refused_with_the_versions_to_update() -> None:
    gid = bytes(range(GID_BYTES))
    labels = [b"\x0fsequence_number", bytes(8), b"\x10source_timestamp", bytes(8), b"\x0asource_gid", b"\x10", gid]
    with pytest.raises(MessageError, match=r"text labels.*0\.2\.4 \(Jazzy\).*update it"):
        parse_attachment(b"".join(labels))


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "attachment of 0 bytes: expected 33"),
        (bytes(34), "attachment of 34 bytes: expected 33"),
        (bytes(33), "an id of 0 bytes: expected 16"),
    ],
)
def test_an_attachment_of_another_form_is_refused(data: bytes, reason: str) -> None:
    with pytest.raises(MessageError, match=reason):
        parse_attachment(data)


def test_an_attachment_that_its_bytes_cannot_hold_is_refused() -> None:
    with pytest.raises(ValueError, match="64 bits"):
        MessageAttachment(2**63, 0, bytes(16)).write()
    with pytest.raises(ValueError, match="found 3 bytes, expected 16"):
        MessageAttachment(1, 0, bytes(3)).write()


@pytest.mark.parametrize(
    ("token", "reason"),
    [
        ("", "expected @ros2_lv"),
        (NODE.replace("@ros2_lv", "@ros3_lv"), "expected @ros2_lv"),
        (NODE.rpartition("/")[0], "found 8 chunks, expected at least 9"),
        (PUBLISHER.rpartition("/")[0], "found 12 chunks, expected at least 13 with MP"),
        (PUBLISHER.replace("/%/%/", "//%/"), "an empty chunk"),
        (PUBLISHER.replace("/MP/", "/MX/"), "'MX', expected one of NN, MP, MS, SS, SC"),
        (NODE.replace("/0/0/", "/0/1/"), "the numbers 0 and 1 of one node"),
        (NODE.replace("/2/", "/-2/"), "'-2', expected a whole number"),
        (NODE.replace("/2/", "/99999999999/"), "domain 99999999999"),
        (NODE.replace("aac3", "AAC3"), "session 'AAC3"),
        (NODE.replace("listener", "li%stener"), "node name 'li/stener'"),
        (PUBLISHER.replace("/%/%/", "/%/%a%%b/"), "namespace: topic '/a//b'"),
        (PUBLISHER.replace("/10/", "/x/"), "'x', expected a whole number"),
        (PUBLISHER.replace("%chatter", "chatter"), "topic 'chatter'"),
        (PUBLISHER.replace("::dds_", ""), "expected package::msg::dds_::Name_"),
        (PUBLISHER.replace("RIHS01", "RIHS02"), "type hash 'RIHS02_"),
    ],
)
def test_a_token_that_is_none_is_refused_with_the_reason(token: str, reason: str) -> None:
    with pytest.raises(MessageError) as refusal:
        parse_token(token)
    assert reason in str(refusal.value)


@few
@given(st.sampled_from(TOKENS), st.randoms(use_true_random=False))
def test_damaged_tokens_are_refused_or_are_other_tokens(token: str, random: Any) -> None:
    chunks = list(token)
    for _ in range(random.randint(1, 4)):
        place = random.randrange(len(chunks) + 1)
        chunks[place : place + random.randint(0, 2)] = random.choice(["", "/", "%", ":", ",", "9", "a", "é", "\0", "*"])
    damaged = "".join(chunks)
    try:
        read = parse_token(damaged)
    except MessageError:
        return
    assert parse_token(read.write()) == read


@few
@given(st.text() | st.binary().map(lambda data: data.decode("latin-1")))
def test_any_text_is_refused_or_read(text: str) -> None:
    for parse in (parse_token, parse_data_key):
        try:
            parse(text)
        except MessageError:
            continue


@few
@given(st.binary(max_size=90))
def test_any_bytes_are_refused_as_attachments_or_survive(data: bytes) -> None:
    try:
        attachment = parse_attachment(data)
    except MessageError:
        return
    assert attachment.write() == data


@pytest.mark.parametrize(
    "build",
    [
        lambda: DataKey(-1, "/a", STRING, None),
        lambda: DataKey(0, "a", STRING, None),
        lambda: DataKey(0, "/a", "String", None),
        lambda: DataKey(0, "/a", STRING, "12"),
        lambda: DataKey(0, "/" + "a" * 247, STRING, None),
        lambda: NodeToken(0, "", 0, "a"),
        lambda: NodeToken(0, "a", 0, "a/b"),
        lambda: NodeToken(0, "a", 0, "a", "b"),
        lambda: all_tokens(-1),
    ],
)
def test_what_ros_does_not_allow_cannot_be_written(build: Any) -> None:
    with pytest.raises(ValueError, match=r"found|expected"):
        build()


def test_the_key_of_all_tokens_includes_each_of_a_domain() -> None:
    zenoh = pytest.importorskip("zenoh")
    everything = zenoh.KeyExpr(all_tokens(2))
    assert [everything.includes(zenoh.KeyExpr(token)) for token in TOKENS] == [True, True, False]
