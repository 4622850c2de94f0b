"""Cores in simulated time: no process, no socket and no clock."""
