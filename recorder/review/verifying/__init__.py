"""Proof of what logs of a robot in signed mode hold: signatures of files and verbs, grants."""
