"""Reads a user's Zenoh configuration file, and fills in what it leaves open.

Zenoh by itself listens on every interface and looks for others by multicast. A file that says
nothing about that must not open the robot to the network, so what it leaves out is filled in
with our defaults rather than with Zenoh's. Paths of certificates and keys are relative to the
file, so that a folder with all of them can be copied anywhere.
"""

from __future__ import annotations

import ipaddress
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import zenoh

from skewmi.errors import ConfigurationError

_PLACE_IN_SOURCE = r" at /\S+:\d+\."

_FILES = (
    "root_ca_certificate",
    "listen_certificate",
    "listen_private_key",
    "connect_certificate",
    "connect_private_key",
)


def load(path: Path | None, defaults: Mapping[str, Any]) -> Any:
    """A Zenoh configuration.

    Args:
        path: The user's file, JSON5 or YAML; None for the defaults alone.
        defaults: Zenoh's path of a setting -> our value where the file has none.

    Raises:
        ConfigurationError: The file or one that it names is missing, or Zenoh refuses it.
    """
    pristine = zenoh.Config()
    config = zenoh.Config() if path is None else _read(path)
    for key, value in defaults.items():
        # Zenoh does not tell whether a value was given; one that equals its own default is taken
        # as not given.
        if config.get_json(key) == pristine.get_json(key):
            config.insert_json5(key, json.dumps(value))
    if path is not None:
        _resolve_files(config, path)
    return config


def locators(config: Any, side: str) -> list[str]:
    """Where a configuration connects to or listens.

    Args:
        config: A Zenoh configuration.
        side: "connect" or "listen".
    """
    endpoints = json.loads(config.get_json(f"{side}/endpoints"))
    if isinstance(endpoints, dict):  # a list for each mode
        endpoints = endpoints.get(json.loads(config.get_json("mode")), [])
    return [endpoint for endpoint in endpoints if isinstance(endpoint, str)]


def is_locator(text: str) -> bool:
    """Whether Zenoh itself takes a text for a place to connect to or listen at."""
    try:
        zenoh.Config().insert_json5("connect/endpoints", json.dumps([text]))
    except zenoh.ZError:
        return False
    return True


def check_protocols(config: Any, path: Path | None) -> None:
    """See whether a configuration allows the links that it asks for.

    Raises:
        ConfigurationError: A locator's protocol is not among those that the file allows.
    """
    allowed = json.loads(config.get_json("transport/link/protocols"))
    for locator in (*locators(config, "listen"), *locators(config, "connect")):
        if allowed is not None and locator.partition("/")[0] not in allowed:
            raise ConfigurationError(
                f"{locator} is not among the protocols that {path} allows ({', '.join(allowed)})"
            )


def is_unprotected(locator: str, config: Any) -> bool:
    """Whether whoever reaches a locator from another machine is let in without a certificate.

    Args:
        locator: Where a session listens.
        config: The session's Zenoh configuration.
    """
    protocol, _, rest = locator.partition("/")
    if protocol in ("unixsock-stream", "unixpipe"):
        return False
    address, _, own = rest.partition("#")
    if protocol in ("tls", "quic") and _asks_for_certificates(own, config):
        return False
    host = address.partition("?")[0].rpartition(":")[0].strip("[]")
    if host == "localhost":
        return False
    try:
        return not ipaddress.ip_address(host).is_loopback
    except ValueError:
        return True


def asks_who(config: Any) -> bool:
    """Whether a configuration lets people do different things, or nobody in without a secret."""
    access = json.loads(config.get_json("access_control/enabled"))
    names = ("usrpwd/user", "usrpwd/dictionary_file", "pubkey/public_key_file")
    secrets = (json.loads(config.get_json(f"transport/auth/{name}")) for name in names)
    return bool(access) or any(secret is not None for secret in secrets)


def _asks_for_certificates(own: str, config: Any) -> bool:
    """Whether a TLS listener demands the client's certificate; by itself TLS does not.

    Args:
        own: The locator's settings, as in `enable_mtls=true;so_sndbuf=1`; they come before the
            configuration's.
        config: The session's Zenoh configuration.
    """
    for setting in own.split(";"):
        name, _, value = setting.partition("=")
        if name == "enable_mtls":
            return value == "true"
    return json.loads(config.get_json("transport/link/tls/enable_mtls")) is True


def first_line(error: Exception) -> str:
    """Zenoh's message without the places in its source that it appends."""
    return re.sub(_PLACE_IN_SOURCE, "", str(error)).splitlines()[0]


def _read(path: Path) -> Any:
    if not path.is_file():
        raise ConfigurationError(f"no Zenoh configuration file at {path}")
    try:
        return zenoh.Config.from_file(str(path))
    except zenoh.ZError as error:
        # A syntax error is a little drawing: the place, the line, an arrow, what was expected.
        place = re.match(r"\s*--> (\d+):(\d+)", str(error))
        expected = re.search(r"^\s*= (.*)$", re.sub(_PLACE_IN_SOURCE, "", str(error)), re.MULTILINE)
        words = first_line(error)
        if place and expected:
            words = f"line {place[1]}, column {place[2]}: {expected[1]}"
        raise ConfigurationError(f"Zenoh cannot use {path}: {words}") from error


def _resolve_files(config: Any, path: Path) -> None:
    """Make the paths of certificates and keys absolute, and see whether they can be read."""
    for name in _FILES:
        key = f"transport/link/tls/{name}"
        given = json.loads(config.get_json(key))
        if given is None:
            continue
        file = (path.parent / given).absolute()
        try:
            file.read_bytes()
        except OSError as error:
            raise ConfigurationError(
                f"cannot read {file} ({error.strerror}), the {name} that {path} names"
            ) from error
        config.insert_json5(key, json.dumps(str(file)))
