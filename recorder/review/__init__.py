"""Questions that a log answers: each is a function here, and a command in ``recorder.cli``.

- ``catalog``            which of very many logs: their rows, and ``find`` in them
- ``info``, ``check``    what a log holds, as it says itself; whether that is true (``checking``, ``flaws``)
- ``cut``                a part of a log, as a log
- ``events``, ``why``    what happened, as ``entries``; why the robot stopped or stood: a ``window`` of the log,
  ``evidence`` for a cause, the ``moment``
- ``drives``             drives, distances and stops, as report, catalog and searches count them
- ``verify``             who commanded, with which grant; is each file as it was signed (``verifying``)
- ``rerun``, ``what_if`` the recorded run again, with its settings or with others
- ``report``             a drive on one page
- ``export``, ``query``  Parquet and CSV; SQL; both on ``columns``
- ``raw_frames``         for the tools of CAN
- ``messages``           a log as typed messages or tables, for programs
- ``tasks``              their parts that processes and machines do beside each other

``recorder.reading`` finds the files and reads them.
"""
