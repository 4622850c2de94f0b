"""Logs as topics and messages, for all questions of the review."""
