"""The second process: stops the robot when the first one no longer can.

It sends nothing while the loop is in time. A loop that comes back in the very moment in which the guard begins may
have one burst under way that it can no longer hold back: once, at most, one burst of each is on the bus together.

    loop  > beat, each tick, after sending       > ``Guardian``     in shared memory
    bus   > feedback, and the loop's own frames  > ``ChassisView``
    guard > late, mute or gone while active?     > ``Stopper``      the stop sequence, on a bus handle of its own

All of it is pure: ``gateway.host.guard_main`` is the process with its one thread, which
``gateway.host.guard_process`` starts.
"""
