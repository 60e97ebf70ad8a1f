"""A secured robot process, and what an intruder may bring along: other keys, other rules."""

from __future__ import annotations

import contextlib
import datetime
import json
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from skewmi.deploy.robot.process import free_port
from skewmi.deploy.wire.access import CONFIG_FILE, Role
from skewmi.deploy.wire.authority import Authority, certificate_pem, key_pem
from skewmi.deploy.wire.certificates import CertificatePlan, write_roles
from skewmi.deploy.wire.transport import TransportConfig

DAY = datetime.timedelta(days=1)


def now() -> datetime.datetime:
    return datetime.datetime.now(datetime.UTC).replace(microsecond=0)


class SecuredLink:
    """Folders as `skewmi certificates` makes them, and the authority that signed them.

    Args:
        directory: Where the folders go; must exist.
        host: Where the robot server listens.
        port: TCP port; None for one that is free.
    """

    def __init__(self, directory: Path, host: str = "localhost", port: int | None = None) -> None:
        self.directory = directory
        self.plan = CertificatePlan((host, "127.0.0.1"), port or free_port())
        self.authority = Authority.make(now() - DAY, now() + DAY)
        self.common_names = write_roles(
            directory, self.plan, self.authority, now() - DAY, now() + DAY
        )

    def file(self, role: Role) -> Path:
        return self.directory / role.value / CONFIG_FILE

    def config(self, role: Role) -> TransportConfig:
        return TransportConfig.for_client(zenoh_config=self.file(role))

    def intruder(self, role: Role, change: Callable[[dict[str, Any]], None]) -> TransportConfig:
        """A role's configuration after somebody has worked on the file."""
        text = re.sub(r"^//.*$", "", self.file(role).read_text(), flags=re.MULTILINE)
        content = json.loads(text)
        change(content)
        path = self.file(role).with_name(f"changed_{len(list(self.directory.rglob('*')))}.json5")
        path.write_text(json.dumps(content))
        return TransportConfig.for_client(zenoh_config=path)

    def without_rules(self, role: Role) -> TransportConfig:
        """With the role's own certificate, but nothing that holds its own session back."""
        return self.intruder(role, lambda content: content.pop("access_control"))

    def with_certificate(
        self,
        authority: Authority,
        common_name: str,
        begins: datetime.datetime,
        ends: datetime.datetime,
    ) -> TransportConfig:
        """A commander's configuration with a certificate of one's own making."""
        certificate, key = authority.sign(common_name, begins, ends)
        folder = self.directory / f"forged_{len(list(self.directory.iterdir()))}"
        folder.mkdir()
        (folder / "certificate.pem").write_bytes(certificate_pem(certificate))
        (folder / "key.pem").write_bytes(key_pem(key))

        def use(content: dict[str, Any]) -> None:
            tls = content["transport"]["link"]["tls"]
            tls["connect_certificate"] = str(folder / "certificate.pem")
            tls["connect_private_key"] = str(folder / "key.pem")
            del content["access_control"]

        return self.intruder(Role.COMMANDER, use)


@contextlib.contextmanager
def robot_process(*options: str) -> Iterator[subprocess.Popen[bytes]]:
    """`skewmi robot` as a user starts it."""
    command = [sys.executable, "-m", "skewmi.cli.main", "robot", *options, "--json"]
    process = subprocess.Popen(
        [*command, "--end-with-input"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    try:
        assert process.stdout is not None
        assert json.loads(process.stdout.readline())["state"] == "disarmed"
        yield process
    finally:
        process.kill()
        process.wait()
