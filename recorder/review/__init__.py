"""Turns a log into answers."""
