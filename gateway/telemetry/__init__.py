"""From message to sample: what a frame says, the whole robot in one message, the gateway's health.

``received`` is the same at the other end: samples as they arrive there.
"""
