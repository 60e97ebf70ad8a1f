"""What a policy sees and does, published for whoever records or watches it."""

from __future__ import annotations

from skewmi.deploy.wire import topics
from skewmi.deploy.wire.channels import Publisher
from skewmi.deploy.wire.messages import JointStates, encode_joint_states
from skewmi.deploy.wire.transport import Link
from skewmi.policy_io import Array, PolicyLayout


class PolicyTopics:
    """Publishes observations and actions by the names of their fields; `open` makes one.

    Args:
        observations: Of `topics.POLICY_OBSERVATION`.
        actions: Of `topics.POLICY_ACTION`.
        layout: Of the policy.
    """

    def __init__(self, observations: Publisher, actions: Publisher, layout: PolicyLayout) -> None:
        self._observations = observations
        self._actions = actions
        self._observation_names = layout.observation_names
        self._action_names = tuple(field.name for field in layout.action)

    @staticmethod
    def open(link: Link, layout: PolicyLayout) -> PolicyTopics:
        """Declare both topics on an open link."""
        observations = link.publisher(topics.POLICY_OBSERVATION)
        return PolicyTopics(observations, link.publisher(topics.POLICY_ACTION), layout)

    @property
    def gids(self) -> dict[str, tuple[bytes, ...]]:
        """Global ids of the publishers, by topic."""
        return {
            topics.POLICY_OBSERVATION.name: (self._observations.gid,),
            topics.POLICY_ACTION.name: (self._actions.gid,),
        }

    def publish(self, stamp_ns: int, observation: Array, action: Array | None = None) -> None:
        """Publish a control step; without an action the observation that ended the episode."""
        self._observations.put(_encode(stamp_ns, self._observation_names, observation))
        if action is not None:
            self._actions.put(_encode(stamp_ns, self._action_names, action))


def _encode(stamp_ns: int, names: tuple[str, ...], values: Array) -> bytes:
    nothing = values[:0]
    return encode_joint_states(JointStates(stamp_ns, names, values, nothing, nothing))
