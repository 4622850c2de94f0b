"""The command flow: request > arbiter > decision > actuation > frames > gate.

No I/O, one thread, time as an argument. ``arbiter`` has a tick's steps; ``verbs`` rules on each request;
``engagement`` has each way into and out of motion. These act on small states: ``lease``, ``operator_link``,
``chassis_monitor``, ``setpoint``, ``output``, ``latches``, ``outbox``. ``motion`` keeps every limit;
``stop`` brings the robot to rest; ``gate`` stands last before the bus and trusts none of them.
"""
