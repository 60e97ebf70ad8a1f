"""Robots are kept apart by their ROS 2 domain, in every command that speaks on the link."""

from __future__ import annotations

from pathlib import Path

import pytest

from skewmi.cli.main import main
from skewmi.deploy.robot.process import spawn_robot
from skewmi.deploy.wire.domain import MAX_DOMAIN, VARIABLE, ros_domain
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.errors import ConfigurationError, TransportError

ON_THE_LINK = {
    "robot": ["--listen", "tcp/127.0.0.1:1"],
    "deploy": ["open_press_close", "--connect", "tcp/127.0.0.1:1"],
    "stop": ["--connect", "tcp/127.0.0.1:1"],
    "certificates": ["--out", "{t}/c", "--host", "localhost"],
}


def test_option_comes_before_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    assert ros_domain(None) == 0
    assert ros_domain(MAX_DOMAIN) == MAX_DOMAIN
    monkeypatch.setenv(VARIABLE, "7")
    assert ros_domain(None) == 7
    assert ros_domain(0) == 0
    monkeypatch.setenv(VARIABLE, "")  # as in ROS 2: not set
    assert ros_domain(None) == 0


@pytest.mark.parametrize("wrong", ["233", "-1", "seven", "7.0", "٣"])
@pytest.mark.parametrize("command", ON_THE_LINK)
def test_wrong_variable_is_named(
    command: str,
    wrong: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv(VARIABLE, wrong)
    words = [word.format(t=tmp_path) for word in ON_THE_LINK[command]]
    assert main([command, *words]) == 2
    assert VARIABLE in capsys.readouterr().err


def test_domain_bounds_agree() -> None:
    TransportConfig(domain=MAX_DOMAIN)
    with pytest.raises(ConfigurationError, match="domain"):
        TransportConfig(domain=MAX_DOMAIN + 1)


def test_certificates_open_the_domain_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(VARIABLE, "7")
    for options, domain in (([], 7), (["--domain", "9"], 9)):
        out = tmp_path / str(domain)
        assert main(["certificates", "--out", str(out), "--host", "localhost", *options]) == 0
        assert f'"{domain}/yumi/' in (out / "robot" / "zenoh.json5").read_text()


def test_robot_answers_in_its_domain_alone() -> None:
    with spawn_robot("sim", "open_press_close", "lab", lock_step=True, domain=7) as locator:
        with Link.open(TransportConfig.for_client(locator, domain=7), "inside") as link:
            assert link.wait_for_robot(60.0)["state"] == "disarmed"
        with (
            Link.open(TransportConfig.for_client(locator), "outside") as link,
            pytest.raises(TransportError, match=r"domain 0.*--domain"),
        ):
            link.wait_for_robot(0.5)
        assert main(["stop", "--connect", locator, "--domain", "7", "--timeout-s", "30"]) == 0
        assert main(["stop", "--connect", locator, "--domain", "8", "--timeout-s", "0.5"]) == 2
