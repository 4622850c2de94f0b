"""Proof of what logs of a robot in signed mode hold: hash chains, signatures, grants."""
