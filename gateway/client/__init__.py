"""The operator's library: connect to a robot, take its lease, drive it, stop it."""
