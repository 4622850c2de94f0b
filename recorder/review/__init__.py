"""Questions about logs: each is a function here, and a command in ``recorder.cli``.

- ``catalog``            a table of many logs, and ``find`` in it
- ``info``, ``check``    the contents of a log by its own account, and whether it is true (``checking``, ``flaws``)
- ``cut``                a part of a log, as a log
- ``events``, ``why``    what happened (``entries``); why a robot stopped (``window``, ``evidence``, ``moment``)
- ``drives``             drives, distances and stops, for report, catalog and searches
- ``verify``             who commanded with which grant, and the signatures of the files (``verifying``)
- ``rerun``, ``what_if`` a recorded run repeated, with its own settings or with others
- ``report``             a drive on one page
- ``export``, ``query``  Parquet, CSV and SQL (``columns``)
- ``raw_frames``, ``rosbag``  for CAN tools, and for ROS 2
- ``messages``           typed messages or tables, for programs
- ``tasks``              work in several processes or machines

``recorder.reading`` finds and reads the files.
"""
