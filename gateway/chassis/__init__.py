"""A chassis on CAN, in general; what is the Cruiser's alone is in ``cruiser``. Pure.

``frame`` is what the bus carries, ``supervision`` sees whether it does in time, ``layout`` decodes and encodes; by
``port`` all others see the chassis. Which one it is, ``gateway.choice`` says.
"""
