"""Take a picture of a view in a real browser, without a screen.

    python docs/make_view_pictures.py run.rrd docs/images/replay.png --click 850,986
    python docs/make_view_pictures.py http://127.0.0.1:9090/?url=... docs/images/live.png

A file is served first, with Rerun's own web viewer; an address is one that `--live` has told.
Needs Debian's `chromium`, and `pip install websockets pillow`. Chromium draws by software
(SwiftShader): a picture takes minutes where the processor is slow.
"""

from __future__ import annotations

import argparse
import asyncio
import base64
import contextlib
import io
import json
import shutil
import subprocess
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import websockets
from PIL import Image

from skewmi.deploy.replay import viewer, web

SIZE = (1600, 1000)
LOADING_SIZE = (320, 200)
"""Data is taken in between two pictures: small ones are drawn sooner."""
COLORS = 256
"""Of the PNG, which keeps it small; with fewer, thin curves lose theirs."""
CHROMIUM = (
    "chromium", "--headless=new", "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--disable-quic", "--no-first-run", "--hide-scrollbars",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
)  # fmt: skip


class Page:
    """A page of a browser, by its debugging protocol.

    Args:
        socket: Connected to the page.
    """

    def __init__(self, socket: Any) -> None:
        self._socket, self._count = socket, 0

    async def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Ask for something, and wait for the answer."""
        self._count += 1
        request = {"id": self._count, "method": method, "params": parameters}
        await self._socket.send(json.dumps(request))
        while True:
            answer = json.loads(await self._socket.recv())
            if answer.get("id") == self._count:
                return dict(answer.get("result", {}))

    async def resize(self, size: tuple[int, int]) -> None:
        """Another size of the window, pixels."""
        await self.call(
            "Emulation.setDeviceMetricsOverride",
            width=size[0],
            height=size[1],
            deviceScaleFactor=1,
            mobile=False,
        )

    async def click(self, x: float, y: float) -> None:
        """Press and release the left button, then leave."""
        for kind, button in (("Moved", "none"), ("Pressed", "left"), ("Released", "left")):
            clicks = 0 if kind == "Moved" else 1
            where = {"x": x, "y": y, "button": button, "clickCount": clicks}
            await self.call("Input.dispatchMouseEvent", type=f"mouse{kind}", **where)
            await asyncio.sleep(0.4)
        await self.call("Input.dispatchMouseEvent", type="mouseMoved", x=5, y=SIZE[1] - 300)

    async def save(self, path: Path) -> None:
        """The page as a PNG of few colors."""
        answer = await self.call("Page.captureScreenshot", format="png")
        picture = Image.open(io.BytesIO(base64.b64decode(answer["data"]))).convert("RGB")
        small = picture.quantize(COLORS, dither=Image.Dither.NONE)
        small.save(path, optimize=True)


async def shoot(port: int, url: str, options: argparse.Namespace) -> None:
    """Open the address, wait, click, and save.

    Args:
        port: Of the browser's debugging protocol.
        url: To open.
        options: See `main`.
    """
    pages = [page for page in browser_pages(port) if page["type"] == "page"]
    address = pages[0]["webSocketDebuggerUrl"]
    async with websockets.connect(address, max_size=None, ping_interval=None) as socket:
        page = Page(socket)
        dark = [{"name": "prefers-color-scheme", "value": "dark"}]
        await page.call("Emulation.setEmulatedMedia", features=dark)
        await page.resize(LOADING_SIZE)
        await page.call("Page.navigate", url=url)
        await asyncio.sleep(options.wait)
        await page.resize(SIZE)
        await asyncio.sleep(options.settle)
        for place in options.click:
            x, y = map(float, place.split(","))
            await page.click(x, y)
            await asyncio.sleep(options.settle)
        await page.save(options.out)


def browser_pages(port: int) -> list[dict[str, Any]]:
    """Pages that a browser has open; waits for it to start."""
    for _ in range(300):
        address = f"http://127.0.0.1:{port}/json"
        with contextlib.suppress(OSError), urllib.request.urlopen(address) as answer:
            return list(json.load(answer))
        time.sleep(0.2)
    raise SystemExit("chromium does not start")


@contextlib.contextmanager
def running(command: list[str]) -> Iterator[None]:
    """A program while the block runs."""
    child = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield
    finally:
        child.terminate()
        child.wait()


def main() -> None:
    """Parse, and take the picture."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", help="Rerun file, or the address of a live view")
    parser.add_argument("out", type=Path, help="PNG file to write")
    parser.add_argument("--wait", type=float, default=150.0, help="for the data, s")
    parser.add_argument("--settle", type=float, default=30.0, help="for the large picture, s")
    parser.add_argument("--click", action="append", default=[], help="X,Y, pixels, before it")
    options = parser.parse_args()
    profile = tempfile.mkdtemp()
    with contextlib.ExitStack() as stack:
        stack.callback(shutil.rmtree, profile, ignore_errors=True)
        url = options.what
        if not url.startswith("http"):
            data, page = web.free_ports()
            serve = [str(viewer._executable()), "--serve-web", url, "--port", str(data)]
            stack.enter_context(running([*serve, "--web-viewer-port", str(page)]))
            url = web.address((data, page))
            time.sleep(5.0)
        port = 9222
        flags = [f"--user-data-dir={profile}", f"--remote-debugging-port={port}", "about:blank"]
        stack.enter_context(running([*CHROMIUM, f"--window-size={SIZE[0]},{SIZE[1]}", *flags]))
        asyncio.run(shoot(port, url, options))


if __name__ == "__main__":
    main()
