"""How a session's status is told apart, and how it says that its policy commands the arm."""

from __future__ import annotations

NAME = "skewmi_deploy"
"""Name under which a session tells its states."""
STATE = "state"
"""Key of the state."""
RUNNING = "running"
"""The state in which the policy commands the hand."""
