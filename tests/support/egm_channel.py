"""An arm's channel and a controller written by hand, on a clock of their own: for tests."""

from __future__ import annotations

from egm_controller import HandController

from skewmi.deploy.robot.backends.egm.channel import ArmChannel, Taken

RAMP_NS = 20_000_000


class Clock:
    """The bridge's clock: it goes on with the controller's packets, however slow this machine."""

    def __init__(self) -> None:
        self.time_ns = 1_000_000_000

    def __call__(self) -> int:
        return self.time_ns

    def wait(self, seconds: float) -> None:
        self.time_ns += int(1e9 * seconds)


class Controller(HandController):
    """Each of its packets comes a cycle after the one before it."""

    def __init__(self, bridge: tuple[str, int], clock: Clock) -> None:
        super().__init__(bridge)
        self.clock = clock

    def bytes_of(self, **changes: object) -> bytes:
        self.clock.wait(0.004032)
        return super().bytes_of(**changes)


def take(channel: ArmChannel) -> Taken | None:
    """What comes within a second."""
    channel.link.wait(1_000_000_000)
    return channel.take()


def guided(channel: ArmChannel, controller: Controller) -> None:
    """Run a session until the ramp is over."""
    for _ in range(8):
        controller.send()
        assert take(channel) is not None
        channel.hold()
        controller.collect(1.0)
    assert channel.readiness() is None
