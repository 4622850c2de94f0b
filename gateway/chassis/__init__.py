"""A chassis on CAN, in general; ``cruiser`` has the Cruiser's part. Pure.

``frame`` is what the bus carries, ``supervision`` checks its timing, ``layout`` decodes and encodes. All other
modules see the chassis through ``port``; ``gateway.choice`` names the chassis in use.
"""
