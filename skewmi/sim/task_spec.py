"""What a task is to everything that does not know it: one `TaskSpec` each."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

from skewmi.batch_env import BatchEnv, TaskMetrics
from skewmi.policy_io import PolicyLayout
from skewmi.sim.variation import Variations

if TYPE_CHECKING:
    from skewmi.sim.arm.arm_task import ArmTask
    from skewmi.sim.offscreen import Image


class Camera(Protocol):
    """Draws copies of one environment."""

    def render(self, index: int) -> Image:
        """Picture of copy `index` now. Shape (height, width, 3)."""

    def close(self) -> None:
        """Give the OpenGL context back."""


@dataclass(frozen=True)
class Caption:
    """How a field of the observation is told to people, rounded to whole units.

    Attributes:
        field: Of the observation.
        label: What it is called.
        unit: That people read.
        scale: How many of these make one of the field's.
        width: Digits that the number is padded to.
    """

    field: str
    label: str
    unit: str
    scale: float = 1.0
    width: int = 3

    def text(self, value: float) -> str:
        """Such as "lid  90 deg"."""
        # What rests on a soft stop is a hair below zero: show 0, not -0.
        number = round(self.scale * value) or 0
        return f"{self.label} {number:{self.width}d} {self.unit}"


@dataclass(frozen=True)
class TaskSpec:
    """A task. Whoever needs one takes it from the registry, `skewmi.sim.tasks`.

    Attributes:
        name: What users call it, the layout's `task`: small letters, digits and underscores.
        layout: Makes the layout from `layout_switches` and `target` as keywords; without any, the
            default one. Reward and success are its reward region and how long that has to be held.
        batch: Makes `BatchEnv`s: `batch(num_envs, num_threads=, seed=, **options)`, where
            `layout_switches` and `target` are among the options.
        camera: Makes what draws copies of one of these, from it, width and height in pixels.
        layout_switches: Options, off by default, that change the layout.
        targets: What the option `target` may be, each a reward region of its own, the default one
            first; empty: there is no such option.
        metrics: What is worth measuring while it is learned.
        planes: Pairs of state fields worth a map of the visited states.
        captions: What a film tells of an observation.
        presets: Configurations to train with, `package.module:ATTRIBUTE` by name, beside those
            that `skewmi.train.presets` has.
        demo: Flags of `skewmi train` with which a newcomer sees a policy converge within minutes;
            empty: there are none known.
        variations: What may differ from the nominal model.
        arm: What stands before the robot; None for a task without a robot, which cannot be
            deployed.
    """

    name: str
    layout: Callable[..., PolicyLayout]
    batch: Callable[..., BatchEnv]
    camera: Callable[[Any, int, int], Camera]
    layout_switches: tuple[str, ...] = ()
    targets: tuple[str, ...] = ()
    metrics: TaskMetrics = field(default_factory=TaskMetrics)
    planes: tuple[tuple[str, str], ...] = ()
    captions: tuple[Caption, ...] = ()
    presets: Mapping[str, str] = field(default_factory=dict)
    demo: tuple[str, ...] = ()
    variations: Variations = field(default_factory=Variations)
    arm: ArmTask | None = None

    @property
    def scene_fields(self) -> dict[str, str]:
        """Observation field of each joint that a robot's scene states tell; empty without one."""
        return {} if self.arm is None else self.arm.scene_fields

    def layouts(self) -> Iterator[tuple[dict[str, bool | str], PolicyLayout]]:
        """Every layout that the task has, with the options that give it, the default one first."""
        # The first target is that of a layout without one.
        for target in (None, *self.targets[1:]):
            for values in itertools.product((False, True), repeat=len(self.layout_switches)):
                switches = zip(self.layout_switches, values, strict=True)
                options: dict[str, bool | str] = {name: True for name, on in switches if on}
                if target is not None:
                    options["target"] = target
                yield options, self.layout(**options)
