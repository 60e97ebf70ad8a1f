"""The batch simulates a model without visual geoms: it must be the one that is shown."""

from __future__ import annotations

import mujoco
import numpy as np

from skewmi.sim.arm.batch import ArmBatch
from skewmi.sim.arm.scene import ArmScene
from skewmi.sim.tasks.open_press_close.definition import ARM


def test_leaving_out_visual_geoms_changes_nothing() -> None:
    scene = ArmScene(ARM)
    shown, stepped = scene.model, scene.physics_model
    assert stepped.ngeom < shown.ngeom
    for name in ("body_mass", "body_inertia", "body_ipos", "body_iquat", "dof_invweight0"):
        np.testing.assert_array_equal(getattr(shown, name), getattr(stepped, name))
    assert (shown.nq, shown.nv, shown.nu) == (stepped.nq, stepped.nv, stepped.nu)

    # Press down on the lid and move along it, so that there is contact.
    env = ArmBatch(ARM, 2, num_threads=1)
    env.reset(0)
    data = [mujoco.MjData(shown) for _ in range(2)]
    for index, single in enumerate(data):
        single.qpos[:] = env.batch.bind("qpos")[index]
        single.ctrl[:] = env.batch.bind("ctrl")[index]
    contacts = 0
    for step in range(25):
        action = np.array([[0.0, 0.2, -1.0], [0.1, 1.0, -1.0]]) * (1.0 if step < 15 else -0.5)
        env.step(action)
        for index, single in enumerate(data):
            for targets in env.servo_targets[index]:
                single.ctrl[:] = targets
                mujoco.mj_step(shown, single)
            contacts += single.ncon
    assert contacts > 10
    for index, single in enumerate(data):
        np.testing.assert_array_equal(env.batch.bind("qpos")[index], single.qpos)
