"""Where a run is shown while it happens."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from skewmi.deploy.replay.viewer import check_url
from skewmi.errors import ConfigurationError


@dataclass(frozen=True)
class LiveOptions:
    """Where a run is shown in Rerun while it happens; at least one place."""

    spawn: bool = False
    """A viewer on this machine, started unless it runs; without a screen, in the browser."""
    connect: str | None = None
    """Address of a viewer that runs, such as rerun+http://127.0.0.1:9876/proxy."""
    out: Path | None = None
    """Rerun file to write; an existing one is replaced."""

    web_ports: tuple[int, int] | None = None
    """Of data and page of a web viewer, served as long as the run lasts; `web.free_ports`."""

    def __post_init__(self) -> None:
        if self.spawn and self.connect is not None:
            raise ConfigurationError(
                "give --live for a viewer on this machine or --live-connect for one that runs, "
                "not both"
            )
        if self.connect is not None:
            check_url(self.connect)
        if self.out is not None and not self.out.parent.is_dir():
            raise ConfigurationError(
                f"cannot write {self.out}: there is no folder {self.out.parent}"
            )
