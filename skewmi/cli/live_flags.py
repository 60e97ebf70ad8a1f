"""Where commands show what they do while they do it: the same three flags everywhere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from skewmi.deploy.replay import viewer
from skewmi.deploy.replay.live_options import LiveOptions
from skewmi.extras import require


def live_options(
    live: bool, connect: str | None, out: Path | None, tell: Callable[[str], None]
) -> LiveOptions | None:
    """Where to show it: in the browser, if there is no screen for a viewer; None if not at all.

    Args:
        live: Whether to show it here.
        connect: Address of a viewer.
        out: Rerun file.
        tell: Told which page to open, if it is to be seen in a browser.

    Raises:
        ConfigurationError: It cannot be shown there.
    """
    options = LiveOptions(live, connect, out)
    if options == LiveOptions():
        return None
    require("a live view", "rerun")
    if not live or viewer.has_screen() or viewer.is_there():
        return options
    # Rerun takes a while to import; its process does so anyway.
    from skewmi.deploy.replay import web

    ports = web.free_ports()
    tell(f"no screen here: open {web.address(ports)} in a browser, as long as the run lasts")
    return replace(options, web_ports=ports)
