"""A small Robot Web Services: HTTP digest, cookies, RAPID data, as RobotWare 6 answers."""

from __future__ import annotations

import hashlib
import json
import re
import secrets
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import TracebackType
from urllib.parse import parse_qs, unquote, urlsplit

REALM = "validusers@robapi.abb"
USER, PASSWORD = "Default User", "robotics"


class RwsServer:
    """Serves RAPID data until the block is left.

    `symbols` holds the values, by the path behind `RAPID/`.
    """

    def __init__(self, symbols: dict[str, str]) -> None:
        self.symbols = symbols
        self.writes: list[tuple[str, str]] = []
        self.challenges = 0
        self.sessions = 0
        self.broken: bytes | None = None
        """Sent instead of every answer."""
        self._nonces: set[str] = set()
        self._cookies: set[str] = set()
        self._http = ThreadingHTTPServer(("127.0.0.1", 0), self._handler())
        self.url = f"http://127.0.0.1:{self._http.server_address[1]}"

    def __enter__(self) -> RwsServer:
        threading.Thread(target=self._http.serve_forever, daemon=True).start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._http.shutdown()
        self._http.server_close()

    def _handler(server: RwsServer) -> type[BaseHTTPRequestHandler]:  # noqa: N805
        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                if self._admitted():
                    self._read(urlsplit(self.path).path)

            def do_POST(self) -> None:
                content = self.rfile.read(int(self.headers.get("Content-Length", "0")))
                if self._admitted():
                    self._write(urlsplit(self.path), content)

            def _admitted(self) -> bool:
                cookie = self.headers.get("Cookie", "")
                if any(known in cookie for known in server._cookies):
                    return True
                if self._digest_is_right(self.headers.get("Authorization", "")):
                    return True
                server.challenges += 1
                nonce = secrets.token_hex(8)
                server._nonces.add(nonce)
                self.send_response(401, "Unauthorized")
                challenge = f'Digest realm="{REALM}", qop="auth", nonce="{nonce}"'
                self.send_header("WWW-Authenticate", challenge)
                self.send_header("Content-Length", "0")
                self.end_headers()
                return False

            def _digest_is_right(self, header: str) -> bool:
                fields = dict(re.findall(r'(\w+)="?([^",]+)"?', header))
                if fields.get("username") != USER or fields.get("nonce") not in server._nonces:
                    return False

                def md5(text: str) -> str:
                    return hashlib.md5(text.encode()).hexdigest()

                secret = md5(f"{USER}:{REALM}:{PASSWORD}")
                asked = md5(f"{self.command}:{fields['uri']}")
                parts = (secret, fields["nonce"], fields["nc"], fields["cnonce"], "auth", asked)
                return fields["response"] == md5(":".join(parts)) and fields["uri"] == self.path

            def _symbol(self, path: str) -> str | None:
                prefix = "/rw/rapid/symbol/data/RAPID/"
                name = unquote(path.removeprefix(prefix))
                return name if path.startswith(prefix) and name in server.symbols else None

            def _read(self, path: str) -> None:
                name = self._symbol(path)
                if name is None:
                    self._refuse()
                    return
                state = {"_type": "rap-data", "_title": "data", "value": server.symbols[name]}
                self._answer(200, {"_links": {}, "_embedded": {"_state": [state]}})

            def _write(self, parts: object, content: bytes) -> None:
                name = self._symbol(parts.path)  # type: ignore[attr-defined]
                if name is None or parts.query != "action=set":  # type: ignore[attr-defined]
                    self._refuse()
                    return
                value = parse_qs(content.decode())["value"][0]
                server.symbols[name] = value
                server.writes.append((name, value))
                self._answer(204, None)

            def _refuse(self) -> None:
                status = {"code": -1073442809, "msg": "SYS_CTRL_E_RESOURCE_NOT_FOUND"}
                self._answer(400, {"_embedded": {"status": status}})

            def _answer(self, code: int, content: object) -> None:
                data = b"" if content is None else json.dumps(content).encode()
                data = data if server.broken is None else server.broken
                self.send_response(code)
                if not self.headers.get("Cookie"):
                    server.sessions += 1
                    cookie = secrets.token_hex(8)
                    server._cookies.add(cookie)
                    self.send_header("Set-Cookie", f"-http-session-={cookie}; path=/")
                self.send_header("Content-Length", str(len(data)))
                self.end_headers()
                self.wfile.write(data)

            def log_message(self, *_: object) -> None:
                pass

        return Handler
