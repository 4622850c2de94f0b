"""A virtual chassis: it behaves as the manual says, with faults on demand. Pure; ``cruiser sim`` runs it.

- ``body``          its figures, with their units, the conditions it is in, and how it moves
- ``disturbances``  the faults that can be asked for, their words, and those in force
- ``model``         the commands it executes and its feedback: ``VirtualChassis``
"""
