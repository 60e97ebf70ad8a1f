"""The environment a learner is handed; the contract itself is `skewmi.batch_env`."""

from skewmi.batch_env import BatchEnv, StepResult

__all__ = ["BatchEnv", "StepResult"]
