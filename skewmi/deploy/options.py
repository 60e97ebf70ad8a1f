"""How a policy is run on a robot."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from skewmi.deploy.replay.live_options import LiveOptions
from skewmi.errors import ConfigurationError


@dataclass(frozen=True)
class DeployOptions:
    """Options of `run_deploy`; see `skewmi deploy --help`."""

    episodes: int = 1
    """How many."""
    seed: int = 0
    """Of the start positions; episode k of two runs with one seed starts alike."""
    robot: str = "sim"
    """Which robot to start, of `deploy.robot.backends`, unless one runs already."""
    connect: str | None = None
    """Zenoh locator of a running robot server; None without `zenoh_config` starts one and ends it
    afterwards."""
    variation: str | None = None
    """Model variation of the simulated robot that is started; not together with `connect` or
    `zenoh_config`."""
    calibration: Path | None = None
    """File of what is known of the robot. The robot that is started gets it, too; one that runs
    already has to have been given the same."""
    domain: int = 0
    """ROS 2 domain of the robot server."""
    lock_step: bool = False
    """Robot server and session wait for each other: fast and repeatable. Simulated robots only."""
    limits: str = "lab"
    """Joint limit profile to plan with."""
    speed: float = 1.0
    """Fraction of the training's speed, 0.1..1; control steps take 1 / speed times as long."""
    lead_ms: float = 24.0
    """Time from a robot state to the start of the motion that answers it, ms, a multiple of 4:
    what planning, link and jitter may take together. More tolerates a busier computer (states may
    be three leads old, at least 100 ms), less reacts faster."""
    start_spread: float = 0.005
    """Half-width of the uniform offset of the hand's start, m per axis, as in training."""
    dry_run: bool = False
    """Do everything but send: the arm does not move."""
    record: Path | None = None
    """MCAP file to write."""
    overwrite: bool = False
    """Replace an existing recording."""
    live: LiveOptions | None = None
    """Where to show the run while it happens."""
    policy_name: str = ""
    """What to call the policy in the recording, such as its file."""
    robot_model_hash: str | None = None
    """Robot model that the policy was trained with, if its file tells."""
    scene_from: str | None = None
    """Who publishes the scene's states, if not the robot server or whom it names: a ROS 2 node's
    name or a publisher's global id."""
    zenoh_config: Path | None = None
    """Zenoh configuration file; says where a running robot server is unless `connect` does."""

    @property
    def starts_robot(self) -> bool:
        """Whether the run starts a robot of its own."""
        return self.connect is None and self.zenoh_config is None

    @property
    def may_wait(self) -> bool:
        """Whether the run may be in lock-step though that was not asked for."""
        return self.starts_robot and not self.dry_run

    def __post_init__(self) -> None:
        if self.episodes < 1:
            raise ConfigurationError(f"episodes is {self.episodes}; it must be at least 1")
        if self.seed < 0:
            raise ConfigurationError(f"seed is {self.seed}; it must not be negative")
        if self.variation is not None and (self.connect or self.zenoh_config) is not None:
            raise ConfigurationError(
                "a variation is of the simulated robot; give --variation to the skewmi robot that "
                "--connect or --zenoh-config names"
            )
        if not 0.1 <= self.speed <= 1.0:
            raise ConfigurationError(f"speed is {self.speed}; it must be in 0.1..1")
        if not (8.0 <= self.lead_ms <= 100.0 and (self.lead_ms / 4.0).is_integer()):
            raise ConfigurationError(
                f"lead_ms is {self.lead_ms}; it must be a multiple of 4 in 8..100"
            )
        if not 0.0 <= self.start_spread <= 0.05:
            raise ConfigurationError(
                f"start_spread is {self.start_spread} m; it must be in 0..0.05 m"
            )
        if self.dry_run and self.lock_step:
            raise ConfigurationError(
                "a dry run sends nothing, and in lock-step time stands still until something is "
                "sent; leave out --lock-step"
            )
