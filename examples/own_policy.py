"""Your own torch policy as a policy file, deployed on the simulated YuMi: one that imitates.

    python examples/own_policy.py [FILE.onnx]      # a minute on one core

Any module with actions in [-1, 1] will do; this one learns from 20 episodes of the bundled policy.
"""

import sys

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

torch.set_num_threads(1)  # faster for small networks, and much faster on a busy computer
teacher, random = OnnxPolicy.load("open_press_close"), np.random.default_rng(0)
batch = tasks.make_batch("open_press_close", 20, time_input=True)
seen, done = [batch.reset(0)], []
while len(done) < batch.layout.episode_steps:
    done.append(teacher.act(seen[-1]))
    disturbed = np.clip(done[-1] + random.normal(0.0, 0.2, done[-1].shape), -1.0, 1.0)
    seen.append(batch.step(disturbed).observation)
x, y = (torch.tensor(np.concatenate(rows), dtype=torch.float32) for rows in (seen[:-1], done))
hidden = [nn.Linear(x.shape[1], 128), nn.ReLU(), nn.Linear(128, 128), nn.ReLU()]
scaled, last = nn.BatchNorm1d(x.shape[1], affine=False), nn.Linear(128, y.shape[1])
module = nn.Sequential(scaled, *hidden, last, nn.Tanh())
adam = torch.optim.Adam(module.parameters(), lr=1e-3)
for _ in range(2000):
    rows = torch.randint(len(x), (256,))
    adam.zero_grad()
    nn.functional.l1_loss(module(x[rows]), y[rows]).backward()
    adam.step()
about = {"method": "imitation", "robot_model_hash": yumi.MODEL_HASH}
policy = TorchPolicy(batch.layout, module, np.zeros(0), about)
written = export_policy(policy, *sys.argv[1:] or ["imitation.onnx"], np.stack(seen))
report = run_deploy(OnnxPolicy.load(written.path), DeployOptions(episodes=3, lock_step=True))
print(f"{report.successes} of {report.planned_episodes} succeeded; stops: {report.stops}")
