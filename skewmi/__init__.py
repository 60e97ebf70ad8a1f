"""skewmi: from one sparse reward to a policy that a YuMi carries out safely."""

__version__ = "0.1.0"
