"""The command flow: request > arbiter > decision > actuation > frames > gate.

No I/O, one thread, time as an argument. ``flow`` has the steps, ``arbiter`` those of a tick and their report;
``verbs`` rules on each request (``rulings``); ``engagement`` has each way into and out of motion. These act on
small states: ``auxiliary``, ``lease``, ``monitor``, ``output``. ``motion`` keeps every limit; ``stop`` brings the
robot to rest; ``restart`` is what survives a restart. The chassis is known by ``gateway.chassis.port`` alone; the
gate, which trusts none of these, comes with it.
"""
