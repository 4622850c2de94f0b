"""The command flow: request > arbiter > decision > actuation > frames > gate.

No I/O, one thread, time as an argument. ``flow`` has all steps; ``arbiter`` has those of a tick and reports them;
``verbs`` rules on each request (``rulings``); ``engagement`` has each way into and out of motion. Their states are
in ``auxiliary``, ``lease``, ``monitor`` and ``output``. ``motion`` applies every limit; ``stop`` brings the robot
to rest; ``restart`` holds what survives a restart. They see the chassis only through ``gateway.chassis.port``. The
gate, which trusts none of them, belongs to the chassis.
"""
