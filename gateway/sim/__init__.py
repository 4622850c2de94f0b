"""A virtual chassis: it behaves as the manual says, with faults on demand.

- ``parameters``   its figures, with their units, and the conditions it is in
- ``motion``       how it moves
- ``model``        the commands it executes and its feedback: ``VirtualChassis``
- ``feedback``     its frames: order, period, alive counter, checksum
- ``faults``       the faults that can be asked for, and their words; ``disturbances`` are those in force
- ``socketcand_protocol`` and ``socketcand``  a CAN bus on a TCP port, for python-can's own ``socketcand``
- ``run``          the chassis in real time, the one place with clocks
- ``command`` and ``fault_command``  ``cruiser sim`` and ``cruiser fault``

All but ``socketcand``, ``typed_lines``, ``run`` and the commands is pure.
"""
