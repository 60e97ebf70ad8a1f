"""How a link is configured: defaults, a Zenoh file, and what is refused."""

from __future__ import annotations

import json

import pytest

from skewmi.deploy.wire.messages import (
    TriggerReply,
)
from skewmi.deploy.wire.topics import (
    YUMI_DESCRIBE,
)
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.errors import ConfigurationError


def test_only_a_real_time_robot_server_puts_out_who_blocks_and_a_file_may_say_otherwise(tmp_path):
    key = "transport/link/tx/queue/congestion_control/block/wait_before_close"
    zenohs_us = 5_000_000

    def wait_us(config: TransportConfig) -> int:
        return json.loads(config.zenoh().get_json(key))

    assert wait_us(TransportConfig.for_robot()) == 2_000
    assert wait_us(TransportConfig.for_robot(lock_step=True)) == zenohs_us
    assert wait_us(TransportConfig.for_client()) == zenohs_us
    file = tmp_path / "zenoh.json5"
    file.write_text(
        "{transport: {link: {rx: {max_message_size: 1000}, tx: {queue: {congestion_control: "
        "{block: {wait_before_close: 70000}}}}}}}"
    )
    config = TransportConfig.for_robot(zenoh_config=file)
    assert wait_us(config) == 70_000
    assert config.zenoh().get_json("transport/link/rx/max_message_size") == "1000"


def test_default_is_loopback_without_scouting():
    config = TransportConfig.for_robot().zenoh()
    servers = config.get_json("listen/endpoints")
    assert "127.0.0.1:7447" in servers
    assert "0.0.0.0" not in servers
    assert json.loads(config.get_json("connect/endpoints")) == []
    for kind in ("multicast", "gossip"):
        assert config.get_json(f"scouting/{kind}/enabled") == "false"
    assert json.loads(TransportConfig.for_client().zenoh().get_json("listen/endpoints")) == []


def test_zenoh_configuration_file_is_used_and_locators_override_it(tmp_path, locator):
    file = tmp_path / "zenoh.json5"
    file.write_text(
        '{mode: "router", listen: {endpoints: ["tcp/127.0.0.1:1"]}, '
        "scouting: {multicast: {enabled: false}}}"
    )
    config = TransportConfig(listen=(locator,), zenoh_config=file)
    with (
        Link.open(config, "endpoint") as server,
        Link.open(TransportConfig.for_client(locator), "client") as client,
    ):
        server.service(YUMI_DESCRIBE, lambda _: TriggerReply(True, "{}"))
        assert client.wait_for_robot(5.0) == {}


def test_bad_configurations_are_refused(tmp_path):
    with pytest.raises(ConfigurationError, match="no Zenoh configuration file"):
        TransportConfig(zenoh_config=tmp_path / "absent.json5").zenoh()
    broken = tmp_path / "broken.json5"
    broken.write_text("{mode: 3")
    with pytest.raises(ConfigurationError, match=r"broken\.json5"):
        TransportConfig(zenoh_config=broken).zenoh()
    with pytest.raises(ConfigurationError, match=r"127\.0\.0\.1:7447"):
        TransportConfig.for_client("127.0.0.1:7447")
    with pytest.raises(ConfigurationError, match="domain"):
        TransportConfig(domain=300)
