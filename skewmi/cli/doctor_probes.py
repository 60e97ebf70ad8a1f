"""Scripts that `skewmi doctor` runs in fresh interpreters, where they may crash or hang."""

from __future__ import annotations

IMPORT = """
import importlib, sys, time
started = time.perf_counter()
importlib.import_module(sys.argv[1])
print(f"imports in {time.perf_counter() - started:.1f} s")
"""

RENDER = """
import sys
import mujoco
model = mujoco.MjModel.from_xml_string(
    '<mujoco><worldbody><light pos="0 0 3"/><geom type="sphere" size="0.1" rgba="1 0 0 1"/>'
    '</worldbody></mujoco>'
)
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
with mujoco.Renderer(model, 48, 64) as renderer:
    renderer.update_scene(data)
    spread = renderer.render().std()
if spread == 0.0:
    sys.exit("the picture is empty")
print("renders a picture")
"""

SIMULATE = """
import sys, time
import numpy as np
from skewmi.sim import tasks
env = tasks.make_batch(sys.argv[1], 8)
env.reset(0)
action = np.zeros((8, env.layout.action_dim))
env.step(action)
started = time.perf_counter()
for _ in range(20):
    env.step(action)
print(f"{160 / (time.perf_counter() - started):.0f} steps/s with 8 environments")
"""

TORCH = """
from skewmi.matrix_kernels import compiler, take_fast_kernels, would_help
fast = take_fast_kernels()
import torch
if torch.cuda.is_available():
    names = [torch.cuda.get_device_name(i) for i in range(torch.cuda.device_count())]
    print(f"torch {torch.__version__}, CUDA: {', '.join(names)}")
else:
    how = ", an AMD one: faster with g++" if would_help() and compiler() is None else ""
    how = ", products by MKL's AVX kernels" if fast else how
    print(f"torch {torch.__version__}, no GPU: trains on the processor{how}")
"""

FIFO = """
import os
os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))
print("allowed")
"""

LOCK_MEMORY = """
import ctypes, os
libc = ctypes.CDLL(None, use_errno=True)
if libc.mlockall(3) != 0:  # MCL_CURRENT | MCL_FUTURE
    raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))
print("allowed")
"""
