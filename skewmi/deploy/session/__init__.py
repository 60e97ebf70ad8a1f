"""What runs a policy on an endpoint, cycle by cycle."""
