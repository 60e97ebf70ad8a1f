"""Render the pictures of the robot model: `MUJOCO_GL=egl python docs/make_robot_picture.py`."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
from PIL import Image

from skewmi.robot_models import mjcf, yumi

WIDTH, HEIGHT = 560, 480


def build() -> mujoco.MjModel:
    """The robot on a floor under studio light."""
    spec = mjcf.build_robot()
    spec.visual.global_.offwidth, spec.visual.global_.offheight = WIDTH, HEIGHT
    spec.visual.quality.offsamples = 8
    spec.visual.headlight.ambient = (0.42, 0.42, 0.42)
    spec.visual.headlight.diffuse = (0.30, 0.30, 0.30)
    spec.worldbody.add_light(
        pos=(1.2, -0.9, 2.0), dir=(-0.6, 0.5, -1.2), diffuse=(0.45, 0.45, 0.43)
    )
    spec.add_texture(
        name="backdrop",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
        rgb1=(0.86, 0.89, 0.92),
        width=16,
        height=96,
    )
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=(4.0, 4.0, 0.1),
        pos=(0.0, 0.0, -0.1),
        rgba=(0.72, 0.77, 0.82, 1.0),
    )
    return spec.compile()


def picture(
    model: mujoco.MjModel, views: list[tuple[tuple[float, ...], float, float]]
) -> np.ndarray:
    """Views side by side; each is (right arm's joints, azimuth deg, elevation deg)."""
    data, camera = mujoco.MjData(model), mujoco.MjvCamera()
    shown = []
    with mujoco.Renderer(model, HEIGHT, WIDTH) as renderer:
        for joints, azimuth, elevation in views:
            data.qpos[:7] = joints
            data.qpos[7:9] = 0.014
            mujoco.mj_forward(model, data)
            camera.azimuth, camera.elevation, camera.distance = azimuth, elevation, 1.25
            camera.lookat[:] = (0.03, -0.03, 0.19)
            renderer.update_scene(data, camera)
            shown.append(renderer.render())
    return np.concatenate(shown, axis=1)


def main() -> None:
    """Write both pictures beside this script."""
    folder = Path(__file__).parent / "images"
    folder.mkdir(exist_ok=True)
    model = build()
    home, start = yumi.HOME["right"], yumi.TABLE_CONFIGURATION
    pictures = {
        "yumi-home.png": [(home, 180.0, -8.0), (home, 135.0, -16.0)],
        "yumi-press-start.png": [(start, 150.0, -16.0), (start, 90.0, -8.0)],
    }
    for name, views in pictures.items():
        Image.fromarray(picture(model, views)).save(folder / name, optimize=True)


if __name__ == "__main__":
    main()
