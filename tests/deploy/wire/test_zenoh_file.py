"""What wrong Zenoh configurations are told, and that a right one can be copied."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from secured_link import SecuredLink

from skewmi.cli.main import main
from skewmi.deploy.wire.access import Role
from skewmi.deploy.wire.transport import Link, TransportConfig
from skewmi.errors import ConfigurationError

BROKEN = {
    "missing file": "no Zenoh configuration file at",
    "bad JSON5": "line 1, column 8: expected",
    "unknown field": "unknown field",
    "missing key": "nowhere.pem (No such file or directory), the listen_private_key that",
    "missing certificate": "the listen_certificate that",
    "missing authority": "the root_ca_certificate that",
    "directory as key": "Is a directory",
    "no key in the file": "No private key found",
    "key of another": "cannot open a Zenoh session",
    "rule of nobody": "cannot open a Zenoh session",
    "plain locator": "is not among the protocols that",
}

NOTICED_BY_CONNECTING = ("key of another", "no key in the file")


@pytest.mark.parametrize(
    ("command", "what"),
    [
        (command, what)
        for command in ("robot", "stop", "deploy")
        for what in BROKEN
        # These take the time-out of three seconds; once is enough.
        if not (command == "deploy" and what in NOTICED_BY_CONNECTING)
    ],
)
def test_wrong_zenoh_configuration_is_one_line(
    tmp_path: Path, command: str, what: str, capsys: pytest.CaptureFixture[str]
) -> None:
    link = SecuredLink(tmp_path)
    side = Role.ROBOT if command == "robot" else Role.COMMANDER
    verb = "listen" if command == "robot" else "connect"
    file = link.file(side)
    content = json.loads(file.read_text()[file.read_text().index("{") :])
    tls = content["transport"]["link"]["tls"]
    if what == "missing file":
        file = tmp_path / "nowhere.json5"
    elif what == "unknown field":
        tls["listen_privat_key"] = "key.pem"
    elif what == "missing key":
        tls[f"{verb}_private_key"] = "nowhere.pem"
    elif what == "missing certificate":
        tls[f"{verb}_certificate"] = "nowhere.pem"
    elif what == "missing authority":
        tls["root_ca_certificate"] = "nowhere.pem"
    elif what == "directory as key":
        tls[f"{verb}_private_key"] = "."
    elif what == "no key in the file":
        tls[f"{verb}_private_key"] = "authority.pem"
    elif what == "key of another":
        tls[f"{verb}_private_key"] = "../observer/key.pem"
    elif what == "rule of nobody":
        content["access_control"]["policies"][0]["rules"].append("nobody's")
    elif what == "plain locator":
        content[verb]["endpoints"] = [f"tcp/localhost:{link.plan.port}"]
    if what == "bad JSON5":
        file.write_text("{mode: ")
    elif what != "missing file":
        file.write_text(json.dumps(content))
    arguments = [command, "--zenoh-config", str(file)]
    if command == "deploy":
        policies = Path(main.__code__.co_filename).parents[1] / "policies"
        arguments.insert(1, str(next(policies.glob("*.onnx"))))
    assert main(arguments) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"skewmi {command}: ")
    assert "Traceback" not in line
    if command != "robot" and what in NOTICED_BY_CONNECTING:
        assert "certificate or key cannot be used" in line
    else:
        assert BROKEN[what].replace("listen_", f"{verb}_") in line


def test_the_folder_can_be_copied_anywhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Paths in the file are relative to it, not to where a command happens to be started."""
    (tmp_path / "made").mkdir()
    link = SecuredLink(tmp_path / "made")
    (tmp_path / "made").rename(tmp_path / "moved")
    link.directory = tmp_path / "moved"
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    server = TransportConfig.for_robot(zenoh_config=link.file(Role.ROBOT))
    with Link.open(server, "server"), Link.open(link.config(Role.COMMANDER), "commander"):
        pass
    relative = Path("../moved") / Role.COMMANDER.value / "zenoh.json5"
    assert TransportConfig.for_client(zenoh_config=relative).zenoh()
    with pytest.raises(ConfigurationError, match="no Zenoh configuration file"):
        TransportConfig.for_client(zenoh_config=Path("commander/zenoh.json5")).zenoh()
