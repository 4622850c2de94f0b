"""From frame to sample: decoded feedback, the whole robot in one message, the gateway's health.

``samples`` has received samples, and the newest published ones.
"""
