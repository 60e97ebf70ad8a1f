"""Somebody else's learner on a task of ours: SAC with hindsight from Stable-Baselines3.

    python examples/gymnasium_sb3.py          # 10,000 steps, some minutes on one core
    python examples/gymnasium_sb3.py 2000     # fewer

The tasks are goal-conditioned Gymnasium environments: `observation`, `achieved_goal`,
`desired_goal`, a reward of 1 where the goal is reached. Goals are drawn near the start here.
"""

import sys

import gymnasium
from stable_baselines3 import SAC, HerReplayBuffer
from stable_baselines3.common.monitor import Monitor


class NearGoals(gymnasium.Wrapper):
    """Each episode asks for another place, at most 1 from the start along either axis."""

    def reset(self, *, seed=None, options=None):
        start, _ = self.env.reset(seed=seed)
        goal = start["achieved_goal"] + self.np_random.uniform(-1.0, 1.0, 2)
        return self.env.reset(options={"desired_goal": goal})


steps = int(sys.argv[1]) if len(sys.argv) > 1 else 10_000
env = Monitor(NearGoals(gymnasium.make("skewmi.sim.gym_envs:skewmi/PointMaze-v0")))
her = {"replay_buffer_class": HerReplayBuffer, "learning_starts": 1_000}
model = SAC("MultiInputPolicy", env, **her, seed=0, verbose=1)
model.learn(steps)

reached = 0
for episode in range(20):
    observation, _ = env.reset(seed=episode)
    over = False
    while not over:
        observation, _, _, over, info = env.step(model.predict(observation, deterministic=True)[0])
        over = over or info["is_success"]
    reached += info["is_success"]
print(f"goals reached: {reached} of 20")
