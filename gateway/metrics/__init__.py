"""Metrics of a fleet for Prometheus: samples in, metric families out. Pure; ``cruiser metrics`` serves them."""
