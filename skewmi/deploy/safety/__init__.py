"""What judges motion: limits, guard, validation and the lease. Knows no planner and no link."""
