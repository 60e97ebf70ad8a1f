"""skewmi: from one sparse reward to a policy that a YuMi carries out safely."""

from skewmi import privacy

__version__ = "0.1.0"

# Before anything else of ours can import what would send something.
privacy.switch_off()
