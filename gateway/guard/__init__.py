"""The second process: stops the robot when the first one no longer can. It never sends while the loop lives.

    loop  > heartbeat, each tick, after sending    > ``Guardian``     in shared memory
    bus   > feedback, and the loop's own frames    > ``Sight``
    guard > late, mute or gone while active?       > ``Stopper``      the stop sequence, on a bus handle of its own

``run`` is its one thread, ``python -m gateway.guard`` the process, ``gateway.ports.guard_process`` what starts it.
"""
