"""The command flow: request > arbiter > decision > actuation > frames > gate.

No I/O, one thread, time as an argument. ``arbiter`` owns the state; ``verbs`` rules on each request; ``motion``
keeps every limit; ``stop`` brings the robot to rest; ``gate`` stands last before the bus and trusts none of them.
"""
