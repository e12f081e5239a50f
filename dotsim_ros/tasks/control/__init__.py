"""What stands between a policy and an arm: limits, stale data, stops, and the record of it."""
