"""Runs in Rerun: recordings as files, deployments live."""
