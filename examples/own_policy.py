"""Your own torch policy as a policy file, deployed on the simulated YuMi: one that imitates.

    python examples/own_policy.py       # writes own.onnx; two minutes on one core

Any module with actions in [-1, 1] will do; this one learns from 40 episodes of the bundled policy.
"""

import numpy as np
import torch
from torch import nn

from skewmi.deploy.options import DeployOptions
from skewmi.deploy.policy import OnnxPolicy
from skewmi.deploy.run import run_deploy
from skewmi.export.onnx_export import export_policy
from skewmi.robot_models import yumi
from skewmi.sim import tasks
from skewmi.train.policy import TorchPolicy

torch.set_num_threads(1)  # faster for small networks
teacher, random = OnnxPolicy.load("open_press_close"), np.random.default_rng(0)
batch = tasks.make_batch("open_press_close", 40, time_input=True)
seen, done = [batch.reset(0)], []
while len(done) < batch.layout.episode_steps:
    done.append(teacher.act(seen[-1]))
    seen.append(batch.step(np.clip(random.normal(done[-1], 0.2), -1.0, 1.0)).observation)
x, y = (torch.tensor(np.concatenate(rows), dtype=torch.float32) for rows in (seen[:-1], done))
layers = [nn.Linear(7, 128), nn.ReLU(), nn.Linear(128, 128), nn.ReLU(), nn.Linear(128, 3)]
module = nn.Sequential(nn.BatchNorm1d(7, affine=False), *layers, nn.Tanh())
adam = torch.optim.Adam(module.parameters(), lr=1e-3)
for _ in range(3000):
    rows = torch.randint(len(x), (256,))
    adam.zero_grad()
    nn.functional.l1_loss(module(x[rows]), y[rows]).backward()
    adam.step()
about = {"method": "mine", "robot_model_hash": yumi.MODEL_HASH}
policy = TorchPolicy(batch.layout, module, np.zeros(0), about)
written = export_policy(policy, "own.onnx", np.stack(seen))
report = run_deploy(OnnxPolicy.load(written.path), DeployOptions(episodes=3, lock_step=True))
print(f"{report.successes} of {report.planned_episodes} succeeded; stops: {report.stops}")
