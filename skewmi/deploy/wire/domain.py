"""Which ROS 2 domain a command talks in: labs keep their robots apart by it."""

from __future__ import annotations

import os

from skewmi.errors import ConfigurationError

VARIABLE = "ROS_DOMAIN_ID"
MAX_DOMAIN = 232
"""ROS 2's highest; DDS computes port numbers from it, and rmw_zenoh puts it before each key."""


def ros_domain(given: int | None) -> int:
    """The domain that an option asks for, else the environment's, else 0, as in ROS 2.

    Args:
        given: The option's value; None if it was not given.

    Raises:
        ConfigurationError: It is not in 0..232.
    """
    text = str(given) if given is not None else os.environ.get(VARIABLE, "") or "0"
    source = VARIABLE if given is None else "--domain"
    if not (text.isascii() and text.isdecimal() and int(text) <= MAX_DOMAIN):
        raise ConfigurationError(f"{source} is {text}; it must be a number in 0..{MAX_DOMAIN}")
    return int(text)
