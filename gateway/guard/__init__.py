"""The second process: stops the robot when the first one no longer can.

It sends nothing while the loop is on time. If the loop recovers just as the guard begins, one last burst of the
loop may overlap with the guard's first.

    loop  > beat, each tick, after sending       > ``Guardian``     in shared memory
    bus   > feedback, and the loop's own frames  > ``ChassisView``
    guard > late, mute or gone while active?     > ``Stopper``      the stop sequence, on a separate bus handle

All of it is pure. ``gateway.host.guard_process`` starts the process, ``gateway.host.guard_main``, which has one
thread.
"""
