"""A virtual chassis that behaves as the manual says, with faults on demand. Pure; ``cruiser sim`` runs it.

- ``body``          physical constants, conditions and motion
- ``disturbances``  the faults: their grammar, and those in force
- ``model``         commands and feedback: ``VirtualChassis``
"""
