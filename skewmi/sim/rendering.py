"""Pictures of any simulation state: frames, films and contact sheets.

Needs OpenGL, but no display: see `offscreen`. Pillow, which only files and labels need, is imported
where it is used: a robot's computer is without it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from types import TracebackType

import mujoco
import numpy as np

from skewmi.errors import ConfigurationError, NotFoundError
from skewmi.outputs import written_aside
from skewmi.sim.offscreen import Image as Frame
from skewmi.sim.offscreen import make_renderer

FILM_SUFFIXES = (".gif", ".webp")


class Renderer:
    """Draws states of one model from its named cameras; a context manager."""

    def __init__(self, model: mujoco.MjModel, *, width: int = 640, height: int = 480) -> None:
        """Open an OpenGL context.

        Args:
            model: Whose states are drawn; its off-screen buffer grows if it is too small.
            width: Pixels.
            height: Pixels.

        Raises:
            ConfigurationError: The size is not positive, or there is no OpenGL; the message says
                which packages give it.
        """
        self.model = model
        self._renderer = make_renderer(model, width, height)
        self._option = mujoco.MjvOption()
        self._option.geomgroup[3] = 0

    def draw(self, data: mujoco.MjData, camera: str = "overview") -> Frame:
        """Draw one state.

        Args:
            data: State of the model; only positions are read, and its kinematics are updated.
            camera: Name of a camera of the model.

        Raises:
            NotFoundError: The model has no such camera.
        """
        names = [self.model.camera(i).name for i in range(self.model.ncam)]
        if camera not in names:
            raise NotFoundError(f"no camera {camera!r}; cameras are {', '.join(names)}")
        mujoco.mj_kinematics(self.model, data)
        mujoco.mj_camlight(self.model, data)
        self._renderer.update_scene(data, camera=camera, scene_option=self._option)
        frame: Frame = self._renderer.render().copy()
        return frame

    def close(self) -> None:
        """Free the OpenGL context."""
        self._renderer.close()

    def __enter__(self) -> Renderer:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def label(frame: Frame, text: str) -> Frame:
    """A copy of a frame with text in its upper left corner."""
    from PIL import Image, ImageDraw, ImageFont

    image = Image.fromarray(frame)
    font = ImageFont.load_default(size=max(12, frame.shape[0] // 18))
    draw = ImageDraw.Draw(image)
    left, top, right, bottom = draw.textbbox((6, 4), text, font=font)
    draw.rectangle((left - 4, top - 3, right + 4, bottom + 3), fill=(20, 20, 24))
    draw.text((6, 4), text, fill=(255, 255, 255), font=font)
    return np.asarray(image)


def write_film(path: Path, frames: Iterable[Frame], *, frames_per_second: float) -> None:
    """Write an endlessly repeating animation, GIF or WebP by the file's suffix.

    Raises:
        ConfigurationError: Another suffix, no frame, a rate that is not positive, or the file
            cannot be written.
    """
    if path.suffix.lower() not in FILM_SUFFIXES:
        raise ConfigurationError(
            f"film {path.name!r}: the suffix must be one of {', '.join(FILM_SUFFIXES)}"
        )
    if not frames_per_second > 0.0:
        raise ConfigurationError(f"frames_per_second is {frames_per_second}; must be positive")
    from PIL import Image

    images = [Image.fromarray(frame) for frame in frames]
    if not images:
        raise ConfigurationError(f"film {path.name!r}: there is no frame to write")
    with written_aside(path) as draft:
        images[0].save(
            draft,
            save_all=True,
            append_images=images[1:],
            duration=round(1000.0 / frames_per_second),
            loop=0,
        )


def contact_sheet(frames: Sequence[Frame], labels: Sequence[str], *, columns: int = 4) -> Frame:
    """Labelled frames of one size side by side, row by row; unused places stay white.

    Raises:
        ConfigurationError: No frame, another number of labels, or frames of several sizes.
    """
    if not frames or len(frames) != len(labels) or columns < 1:
        raise ConfigurationError(
            f"a contact sheet needs as many labels as frames and a column; got {len(frames)} "
            f"frames, {len(labels)} labels, {columns} columns"
        )
    shapes = {frame.shape for frame in frames}
    if len(shapes) > 1:
        raise ConfigurationError(f"frames of a contact sheet differ in size: {sorted(shapes)}")
    height, width, _ = frames[0].shape
    rows = -(-len(frames) // columns)
    sheet = np.full((rows * height, min(columns, len(frames)) * width, 3), 255, dtype=np.uint8)
    for i, (frame, text) in enumerate(zip(frames, labels, strict=True)):
        top, left = (i // columns) * height, (i % columns) * width
        sheet[top : top + height, left : left + width] = label(frame, text)
    return sheet


def write_picture(path: Path, frame: Frame) -> None:
    """Write one frame; the suffix gives the format (PNG, JPEG, WebP).

    Raises:
        ConfigurationError: Another suffix, or the file cannot be written.
    """
    from PIL import Image

    try:
        with written_aside(path) as draft:
            Image.fromarray(frame).save(draft)
    except ValueError as error:
        raise ConfigurationError(f"picture {path.name!r}: {error}") from error
