"""Robots live in Foxglove and Lichtblick: channels and records as in a log, over a WebSocket."""
