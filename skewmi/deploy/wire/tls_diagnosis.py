"""Why a TLS link does not come about.

Zenoh says only that it timed out. Asking again with Python's own TLS, with the same files, tells
whether nobody listens, whether we refuse the server's certificate or it refuses ours, and why.
"""

from __future__ import annotations

import json
import socket
import ssl
from typing import Any

from skewmi.deploy.wire.zenoh_file import locators

_TIMEOUT_S = 2.0


def why_not_connected(config: Any) -> str | None:
    """The reason in words why a Zenoh configuration's first TLS locator cannot be connected to.

    Args:
        config: A Zenoh configuration with absolute paths.

    Returns:
        None if it does not connect by TLS, or if nothing is wrong with the TLS handshake.
    """
    tls_locators = [e for e in locators(config, "connect") if e.startswith("tls/")]
    if not tls_locators:
        return None
    address = tls_locators[0].removeprefix("tls/").partition("#")[0].partition("?")[0]
    host, _, port = address.rpartition(":")
    tls = {
        name: json.loads(config.get_json(f"transport/link/tls/{name}"))
        for name in (
            "root_ca_certificate",
            "connect_certificate",
            "connect_private_key",
            "enable_mtls",
        )
    }
    try:
        context = ssl.create_default_context(cafile=tls["root_ca_certificate"])
        if tls["enable_mtls"] and tls["connect_certificate"] and tls["connect_private_key"]:
            context.load_cert_chain(tls["connect_certificate"], tls["connect_private_key"])
    except (OSError, ValueError) as error:
        return f"certificate or key cannot be used: {_words(error)}"
    try:
        return _handshake(context, host.strip("[]"), int(port))
    except (OSError, ValueError):
        return None  # nobody listens, or not at such an address: the caller says so


def _handshake(context: ssl.SSLContext, host: str, port: int) -> str | None:
    with socket.create_connection((host, port), timeout=_TIMEOUT_S) as raw:
        try:
            connection = context.wrap_socket(raw, server_hostname=host)
        except ssl.SSLCertVerificationError as error:
            return f"the robot server's certificate is refused: {error.verify_message}"
        except (ssl.SSLError, ConnectionError) as error:
            return f"what listens there does not speak TLS with us: {_words(error)}"
        with connection:
            try:
                # In TLS 1.3 the server judges our certificate after our side is done.
                connection.settimeout(0.5)
                connection.recv(1)
            except TimeoutError:
                return None
            except (ssl.SSLError, ConnectionError) as error:
                return f"the robot server refuses our certificate: {_words(error)}"
    return None


def _words(error: Exception) -> str:
    reason = getattr(error, "reason", None)
    if isinstance(reason, str):
        return reason.replace("_", " ").lower()
    # As OpenSSL says "PEM lib" of a file that holds something else.
    return "not a PEM file of the right kind" if "PEM lib" in str(error) else str(error)
