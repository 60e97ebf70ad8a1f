"""Keys, tokens and attachments as rmw_zenoh spells them."""

from __future__ import annotations

import re
import struct

import pytest
import xxhash
import zenoh

from skewmi.deploy.wire import ros2_keys, ros2_types, topics
from skewmi.deploy.wire.ros2_keys import EntityKind
from skewmi.errors import TransportError


def test_type_hashes_are_those_of_ros2():
    # As ros2 computes them; the service's covers request, response and event.
    assert ros2_types.type_hash(topics.JOINT_TRAJECTORY) == (
        "RIHS01_179b33eba59d676f6d967ac71fe35e7ca2f64b2f3928f4a018cec115e213796e"
    )
    assert ros2_types.type_hash(topics.JOINT_STATE) == (
        "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e"
    )
    assert ros2_types.type_hash(topics.TRIGGER) == (
        "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"
    )


@pytest.mark.parametrize("topic", [*topics.TOPICS, *topics.SERVICES], ids=lambda t: t.name)
def test_keys_and_tokens_have_the_form_of_rmw_zenoh(topic):
    chunk = r"[^/%*$?#]+"
    kind = "srv" if topic.type_name == topics.TRIGGER else "msg"
    types = rf"{chunk}::{kind}::dds_::{chunk}_/RIHS01_[0-9a-f]{{64}}"
    assert re.fullmatch(rf"5{topic.name}/{types}", ros2_keys.data_key(5, topic))
    node = ros2_keys.Node(5, "ab12", "skewmi_endpoint")
    assert ros2_keys.node_token(node) == "@ros2_lv/5/ab12/0/0/NN/%/%/skewmi_endpoint"
    token = ros2_keys.endpoint_token(node, 3, EntityKind.PUBLISHER, topic, "::,10:,:,:,,")
    name = topic.name.replace("/", "%")
    pattern = rf"@ros2_lv/5/ab12/0/3/MP/%/%/skewmi_endpoint/{name}/{types}/::,10:,:,:,,"
    assert re.fullmatch(pattern, token)
    zenoh.KeyExpr(token)  # Zenoh accepts it as a key
    assert ros2_keys.session_of_token(token) == "ab12"


def test_attachment_is_what_zenoh_serializes():
    entity_gid = ros2_keys.gid("@ros2_lv/0/a/0/1/MP/%/%/n")
    attachment = ros2_keys.encode_attachment(7, 1_700_000_000_123_456_789, entity_gid)
    expected = zenoh.ext.z_serialize(
        (zenoh.ext.Int64(7), zenoh.ext.Int64(1_700_000_000_123_456_789), entity_gid)
    )
    assert attachment == expected.to_bytes()
    assert len(attachment) == 33
    assert ros2_keys.decode_attachment(attachment) == (7, 1_700_000_000_123_456_789, entity_gid)
    # Low half first.
    digest = xxhash.xxh3_128_intdigest(b"@ros2_lv/0/a/0/1/MP/%/%/n")
    assert struct.unpack("<QQ", entity_gid) == (digest & (2**64 - 1), digest >> 64)


@pytest.mark.parametrize("attachment", [b"", b"x" * 33, b"\x00" * 32, b"\x00" * 34])
def test_other_attachments_are_refused(attachment):
    with pytest.raises(TransportError):
        ros2_keys.decode_attachment(attachment)


def test_tokens_tell_node_and_topic_whatever_somebody_has_declared():
    node = ros2_keys.Node(0, "ab12", "camera")
    kind, topic = EntityKind.PUBLISHER, topics.YUMI_SCENE_STATES
    token = ros2_keys.endpoint_token(node, 3, kind, topic, ros2_keys.QOS_RELIABLE_10)
    assert ros2_keys.node_of_token(token) == "camera"
    assert ros2_keys.node_of_token(ros2_keys.node_token(node)) == "camera"
    assert ros2_keys.is_token_of(token, kind, topic)
    assert not ros2_keys.is_token_of(token, EntityKind.SUBSCRIPTION, topic)
    assert not ros2_keys.is_token_of(token, kind, topics.YUMI_STATUS)
    odd = ros2_keys.Node(0, "ab12", "\x1b]0;owned\x07" + "x" * 1000)
    assert ros2_keys.node_of_token(ros2_keys.node_token(odd)) == "?]0;owned?" + "x" * 54
    for token in ("", "@ros2_lv", "@ros2_lv/0/ab12/0/3/MP/%/%"):
        assert ros2_keys.node_of_token(token) == ""
        assert not ros2_keys.is_token_of(token, kind, topic)
