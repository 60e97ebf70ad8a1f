"""Make certificates and Zenoh configurations for a link between two machines.

Writes a folder per role: `robot server` for the machine with the robot, `commander` for the machine
that runs `skewmi deploy` and `skewmi stop`, `observer` for those who only read states. Copy each
to its machine and pass its `zenoh.json5` as `--zenoh-config`. Every certificate is signed by an
authority whose key is not kept: run the command again to replace them all, before they expire
or when a key may have been stolen.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from skewmi import extras
from skewmi.deploy.wire.domain import ros_domain


@dataclass(frozen=True)
class CertificatesCommand:
    """Options of `skewmi certificates`."""

    out: Path
    """Directory to make."""
    host: tuple[str, ...]
    """Names and addresses of the machine with the robot; the others connect to the first."""
    listen: str | None = None
    """Address on that machine to listen on; by default the first --host."""
    port: int = 7447
    """TCP port to listen on."""
    domain: int | None = None
    """ROS 2 domain that is opened up, 0..232; by default ROS_DOMAIN_ID, else 0. Robot and
    commands must be in the same one."""
    days: int = 90
    """How long the certificates are valid, days."""
    overwrite: bool = False
    """Replace what an earlier call has made, keys included."""
    json: bool = False
    """Print what was made as one JSON document."""


def run_certificates(options: CertificatesCommand) -> int:
    """Make everything. Returns 0."""
    try:
        from skewmi.deploy.wire.certificates import CertificatePlan, write_certificates
    except ModuleNotFoundError as error:
        raise extras.missing("`skewmi certificates`", error) from error
    plan = CertificatePlan(
        options.host, options.port, options.listen, options.days, ros_domain(options.domain)
    )
    written = write_certificates(options.out, plan, overwrite=options.overwrite)
    files = {role.value: str(path) for role, path in written.configurations.items()}
    if options.json:
        print(json.dumps({"expires": written.expires.isoformat(), "zenoh_config": files}))
        return 0
    print(f"valid until {written.expires:%Y-%m-%d %H:%M} UTC; copy each folder to its machine")
    print(f"robot:    skewmi robot --zenoh-config {files['robot']}")
    print(f"commands: skewmi deploy POLICY --zenoh-config {files['commander']}")
    print(f"watchers: {files['observer']}")
    return 0
