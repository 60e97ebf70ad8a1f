"""Robot Web Services of RobotWare 6, as far as a gripper needs them: read and write RAPID data.

RWS 1.0 is HTTP with digest authentication; its sessions are cookies, of which a controller has
seventy, so all requests share one.
"""

from __future__ import annotations

import json
import urllib.error
import urllib.request
from http.cookiejar import CookieJar
from typing import Any
from urllib.parse import quote, urlencode, urlsplit

from skewmi.errors import ConfigurationError, TransportError

DEFAULT_USER = "Default User"
DEFAULT_PASSWORD = "robotics"
"""What every controller is shipped with, see ABB's RWS documentation."""

_SYMBOLS = "/rw/rapid/symbol/data/RAPID"
_MAX_ANSWER = 1 << 16


class RwsClient:
    """Talks to one controller. Every call waits for its answer; one thread.

    Args:
        url: Of the controller, such as http://192.168.125.1.
        user: Of the controller's user authorisation system.
        password: Of that user.
        timeout_s: Longest wait for an answer, s.

    Raises:
        ConfigurationError: Not such an address.
    """

    def __init__(
        self,
        url: str,
        user: str = DEFAULT_USER,
        password: str = DEFAULT_PASSWORD,
        timeout_s: float = 2.0,
    ) -> None:
        parts = urlsplit(url)
        if parts.scheme != "http" or not parts.hostname or parts.path not in ("", "/"):
            raise ConfigurationError(
                f"{url!r} is no address of Robot Web Services; RobotWare 6 has "
                "http://ADDRESS[:PORT]"
            )
        self._url = f"http://{parts.netloc}"
        self._timeout_s = timeout_s
        passwords = urllib.request.HTTPPasswordMgrWithDefaultRealm()
        passwords.add_password(None, self._url, user, password)
        self._opener = urllib.request.build_opener(
            # No proxy: the controller is on a cable of its own.
            urllib.request.ProxyHandler({}),
            urllib.request.HTTPDigestAuthHandler(passwords),
            urllib.request.HTTPCookieProcessor(CookieJar()),
        )

    def read_symbol(self, task: str, module: str, symbol: str) -> str:
        """Value of a RAPID variable, as RAPID writes it.

        Raises:
            TransportError: The controller does not answer, or does not know it.
        """
        answer = self._ask(f"{self._path(task, module, symbol)}?json=1")
        try:
            value = json.loads(answer)["_embedded"]["_state"][0]["value"]
        except (ValueError, KeyError, IndexError, TypeError) as error:
            raise TransportError(
                f"{self._url} answers {answer[:60]!r} where the value of {symbol} is expected"
            ) from error
        return str(value)

    def write_symbol(self, task: str, module: str, symbol: str, value: str) -> None:
        """Set a persistent RAPID variable.

        Raises:
            TransportError: The controller does not answer, or refuses.
        """
        self._ask(
            f"{self._path(task, module, symbol)}?action=set", urlencode({"value": value}).encode()
        )

    def _path(self, *names: str) -> str:
        return "/".join((_SYMBOLS, *(quote(name, safe="") for name in names)))

    def _ask(self, path: str, content: bytes | None = None) -> str:
        request = urllib.request.Request(self._url + path, data=content)
        try:
            with self._opener.open(request, timeout=self._timeout_s) as answer:
                return str(answer.read(_MAX_ANSWER).decode("utf-8", errors="replace"))
        except urllib.error.HTTPError as error:
            with error:
                detail = _message(error.read(_MAX_ANSWER))
            raise TransportError(
                f"{self._url} answers {error.code} ({detail or error.reason})"
            ) from error
        except (OSError, ValueError) as error:
            # URLError is an OSError; digest raises ValueError for what it does not know.
            reason = getattr(error, "reason", error)
            raise TransportError(f"{self._url} does not answer: {reason}") from error


def _message(answer: bytes) -> str:
    """What the controller says went wrong; empty if it says nothing that can be read."""
    try:
        status: Any = json.loads(answer)["_embedded"]["status"]
        return str(status.get("msg", ""))[:200]
    except (ValueError, KeyError, TypeError, AttributeError):
        return ""
