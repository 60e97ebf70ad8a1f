"""The session: runs a policy on a robot server, episode by episode, and always ends at rest.

Nothing that goes wrong in an episode leaves `run`: it becomes a stop or a fault with its reason.
Stopping means to send nothing more; the chunk that the robot server accepted last ends at rest.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from skewmi.deploy.options import DeployOptions
from skewmi.deploy.realtime import hot_loop
from skewmi.deploy.report import DeployReport, RunProgress
from skewmi.deploy.session.episode import EpisodeRunner
from skewmi.deploy.session.states import SessionEvent
from skewmi.deploy.session.status import SessionStatus
from skewmi.deploy.session.steadiness import TooBusyError
from skewmi.deploy.session.stream import ChunkStream
from skewmi.deploy.session.timing import BUSY_ADVICE, CycleTimes
from skewmi.deploy.session.trust import Trust


class Session:
    """Runs episodes of one policy on one robot server; `connect.connect` makes one.

    Args:
        options: How many episodes, at which pace.
        episodes: Runs them.
        status: Told what happens.
        trust: Knows who else was heard.
        stream: Knows what was sent.
        times: How long the cycles took.
        report: Filled in as the run goes on.
        stop: Set from outside to end the run with a smooth stop.
        can_wait: Whether the robot could wait for this computer where that is too slow.
        tell: Told in words what happens.
    """

    def __init__(
        self,
        options: DeployOptions,
        episodes: EpisodeRunner,
        status: SessionStatus,
        trust: Trust,
        stream: ChunkStream,
        times: CycleTimes,
        report: DeployReport,
        stop: threading.Event,
        can_wait: bool,
        tell: Callable[[str], None],
    ) -> None:
        self._options = options
        self._episodes = episodes
        self._status = status
        self.trust = trust
        self._stream = stream
        self._times = times
        self._report = report
        self._stop = stop
        self._can_wait = can_wait
        self._tell = tell
        self._warned: set[str] = set()

    def run(self) -> None:
        """Run all episodes; what happened is in the report.

        Raises:
            TooBusyError: States or commands came too late for a robot that could wait.
        """
        for index in range(self._options.episodes):
            if index > 0:
                self._status.fire(SessionEvent.NEXT_EPISODE, f"episode {index + 1}")
            with hot_loop(priority=not self._options.lock_step) as granted:
                go_on = self._episode(index)
            self._report.granted = granted
            if not go_on:
                break
        self._status.fire(SessionEvent.FINISH, "all episodes are over")
        report = self._report
        report.usage = self._stream.usage
        report.cycles = self._times.cycles
        report.cycle_ms = self._times.cycle_percentiles_ms()
        report.stage_ms = self._times.stage_percentiles_ms()
        report.missed_cycles = self._stream.missed_cycles
        report.interrupted = self._stop.is_set()
        report.add_strangers(self.trust.senders.strangers())

    def progress(self) -> RunProgress:
        """How far the run is; may be asked from any thread, and holds nobody up."""
        steps, of = self._episodes.steps
        return RunProgress(
            state=self._status.state.value,
            episode=min(len(self._report.episodes) + 1, self._options.episodes),
            episodes=self._options.episodes,
            step=steps,
            steps=of,
            missed_cycles=self._stream.missed_cycles,
        )

    def _episode(self, index: int) -> bool:
        """One episode; whether to go on with the next."""
        episode, go_on = self._episodes.run(index)
        self._warn()
        if episode.outcome in ("stopped", "fault"):
            self._report.stops.append(episode.reason)
        self._report.episodes.append(episode)
        self._tell(
            f"episode {index + 1}: {episode.outcome} after {episode.steps} steps ({episode.reason})"
        )
        if self._can_wait and episode.reason.endswith(BUSY_ADVICE):
            raise TooBusyError(episode.reason)
        return go_on and not self._stop.is_set()

    def _warn(self) -> None:
        """Name each sender that was not believed, once."""
        for stranger in self.trust.senders.strangers():
            name = str(stranger)
            if name not in self._warned:
                self._warned.add(name)
                self._tell(
                    f"warning: {name} is not the robot server; {stranger.messages} messages so "
                    "far were left out"
                )
