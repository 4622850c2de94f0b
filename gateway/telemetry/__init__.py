"""From message to sample: what a frame says, the whole robot in one message, the gateway's health.

``samples`` are those that are published, and those that arrive at the other end.
"""
