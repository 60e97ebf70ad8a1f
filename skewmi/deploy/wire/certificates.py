"""Certificates and Zenoh configurations for a link between machines, made in one go.

One call makes a private certificate authority, a certificate for each role and a folder for
each machine. The authority's own key is never written: it signs three certificates and is
forgotten, so that nobody can steal it, and making everything anew shuts out whatever was signed
before. That takes the place of revocation lists, which Zenoh does not read.

What each role may say is in `access`; docs/security.md tells how to use all this.
"""

from __future__ import annotations

import datetime
import ipaddress
import os
import re
import secrets
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

from skewmi.deploy.wire.access import (
    AUTHORITY_FILE,
    CERTIFICATE_FILE,
    CONFIG_FILE,
    KEY_FILE,
    Role,
    zenoh_configuration,
)
from skewmi.deploy.wire.authority import Authority, certificate_pem, ip_address, key_pem
from skewmi.errors import ConfigurationError

MAX_DAYS = 825
"""Longest life of a certificate; what browsers allowed private authorities for years."""

_CLOCK_SKEW = datetime.timedelta(hours=1)
"""Certificates are valid from this long before they are made: robots' clocks may be behind."""

_HOST_NAME = re.compile(r"(?!-)[A-Za-z0-9-]{1,63}(\.(?!-)[A-Za-z0-9-]{1,63})*")


@dataclass(frozen=True)
class CertificatePlan:
    """What to make."""

    hosts: tuple[str, ...]
    """Names and addresses under which the robot server's machine is reached; the first is where the
    others connect to."""
    port: int = 7447
    """TCP port that the robot server listens on."""
    listen: str | None = None
    """Address of the robot server's machine to listen on; None: the first of `hosts`."""
    days: int = 90
    """How long the certificates are valid, days."""
    domain: int = 0
    """ROS 2 domain whose topics and services are opened up."""

    def __post_init__(self) -> None:
        if not self.hosts:
            raise ConfigurationError("give the name or address of the server's machine (--host)")
        for host in (*self.hosts, *((self.listen,) if self.listen is not None else ())):
            if ip_address(host) is None and not _HOST_NAME.fullmatch(host):
                raise ConfigurationError(
                    f"{host!r} is neither a host name nor an IP address; "
                    "write it without protocol and port"
                )
        if not 0 < self.port < 65536:
            raise ConfigurationError(f"port {self.port} is not in 1..65535")
        if not 1 <= self.days <= MAX_DAYS:
            raise ConfigurationError(f"days is {self.days}; it must be in 1..{MAX_DAYS}")
        if not 0 <= self.domain <= 232:
            raise ConfigurationError(f"ROS 2 domain {self.domain} is not in 0..232")

    @property
    def connect_locator(self) -> str:
        """Where commander and observer connect to."""
        return f"tls/{_bracketed(self.hosts[0])}:{self.port}"

    @property
    def listen_locator(self) -> str:
        """Where the robot server listens."""
        return f"tls/{_bracketed(self.listen or self.hosts[0])}:{self.port}"


@dataclass(frozen=True)
class WrittenCertificates:
    """What was made."""

    directory: Path
    expires: datetime.datetime
    """When the certificates end, UTC."""
    configurations: dict[Role, Path]
    """The Zenoh configuration file of each role."""


def write_certificates(
    directory: Path, plan: CertificatePlan, *, overwrite: bool = False
) -> WrittenCertificates:
    """Make an authority, a certificate for each role, and a folder for each role.

    Everything is written beside `directory` first and moved there when it is complete; private
    keys are readable by their owner alone from the moment they exist.

    Args:
        directory: To make; `directory/<role>` holds everything that one role's machine needs.
        plan: Hosts, port, lifetime.
        overwrite: Replace `directory` if an earlier call has made it.

    Raises:
        ConfigurationError: The directory exists and may not be replaced, holds other things, or
            cannot be written.
    """
    _check_replaceable(directory, overwrite)
    now = datetime.datetime.now(datetime.UTC).replace(microsecond=0)
    begins, ends = now - _CLOCK_SKEW, now + datetime.timedelta(days=plan.days)
    try:
        directory.parent.mkdir(parents=True, exist_ok=True)
        # Made with mode 0700, as mkdtemp does.
        draft = Path(tempfile.mkdtemp(prefix=f".{directory.name}.", dir=directory.parent))
        try:
            write_roles(draft, plan, Authority.make(begins, ends), begins, ends)
            _replace(directory, draft)
        finally:
            shutil.rmtree(draft, ignore_errors=True)
    except OSError as error:
        raise ConfigurationError(f"cannot write {directory}: {error}") from error
    files = {role: directory / role.value / CONFIG_FILE for role in Role}
    return WrittenCertificates(directory, ends, files)


def write_roles(
    directory: Path,
    plan: CertificatePlan,
    authority: Authority,
    begins: datetime.datetime,
    ends: datetime.datetime,
) -> dict[Role, str]:
    """Write the folder of each role into an existing directory.

    Args:
        directory: Where; it has no folders of roles yet.
        plan: Hosts and port.
        authority: Signs.
        begins: When the certificates become valid.
        ends: When they end.

    Returns:
        The common name in each role's certificate, by which the access rules know it.

    Raises:
        OSError: Something cannot be written.
    """
    # A common name of this issue alone: the access rules name exactly these certificates.
    issue = secrets.token_hex(8)
    common_names = {role: f"skewmi-{role.value}-{issue}" for role in Role}
    for role in Role:
        folder = directory / role.value
        folder.mkdir(mode=0o700)
        hosts = plan.hosts if role is Role.ROBOT else ()
        certificate, key = authority.sign(common_names[role], begins, ends, hosts)
        _write(folder / AUTHORITY_FILE, certificate_pem(authority.certificate), 0o644)
        _write(folder / CERTIFICATE_FILE, certificate_pem(certificate), 0o644)
        _write(folder / KEY_FILE, key_pem(key), 0o600)
        locator = plan.listen_locator if role is Role.ROBOT else plan.connect_locator
        text = zenoh_configuration(role, locator, common_names, plan.domain)
        _write(folder / CONFIG_FILE, text.encode(), 0o644)
    return common_names


def _check_replaceable(directory: Path, overwrite: bool) -> None:
    if not directory.exists() and not directory.is_symlink():
        return
    if directory.is_symlink() or not directory.is_dir():
        raise ConfigurationError(f"{directory} exists and is not a directory")
    if not any(directory.iterdir()):
        return
    if not overwrite:
        raise ConfigurationError(f"{directory} exists; give another directory or --overwrite")
    ours = {Path(role.value) for role in Role}
    files = (AUTHORITY_FILE, CERTIFICATE_FILE, KEY_FILE, CONFIG_FILE)
    ours |= {Path(role.value) / name for role in Role for name in files}
    for path in sorted(directory.rglob("*")):
        if path.relative_to(directory) not in ours:
            raise ConfigurationError(
                f"{directory} holds something else than certificates ({path.name}); "
                "give another directory"
            )


def _replace(directory: Path, draft: Path) -> None:
    """Put `draft` in the place of `directory`; the earlier one stays until the new one is there."""
    if not directory.exists():
        draft.rename(directory)
        return
    earlier = Path(tempfile.mkdtemp(prefix=f".{directory.name}.old.", dir=directory.parent))
    directory.rename(earlier / "was")
    try:
        draft.rename(directory)
    except OSError:
        (earlier / "was").rename(directory)
        raise
    finally:
        shutil.rmtree(earlier, ignore_errors=True)


def _write(path: Path, content: bytes, mode: int) -> None:
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    with os.fdopen(descriptor, "wb") as file:
        os.fchmod(file.fileno(), mode)  # whatever the umask says
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def _bracketed(host: str) -> str:
    return f"[{host}]" if isinstance(ip_address(host), ipaddress.IPv6Address) else host
