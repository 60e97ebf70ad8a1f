"""What runs a policy on a robot server, cycle by cycle."""
