"""Questions that a log answers: each is a function here, and a command in ``recorder.cli.review``.

- ``find``, ``catalog``  which of very many logs; their rows
- ``info``, ``check``    what a log holds, as it says itself; whether that is true (``checking``)
- ``cut``                a part of a log, as a log
- ``events``             what happened (``entries``, ``stops``, ``repeats``, ``clock``)
- ``why``                why the robot stopped or stood (``story``, ``moment``, ``stopping``, ``evidence``,
  ``window``, ``chain``)
- ``verify``             who commanded, with which grant; is each file as it was signed (``verifying``)
- ``drives``             drives, distances and stops, as report, catalog and searches count them
- ``rerun``              the recorded run again, with its settings or with others
- ``report``             a drive on one page
- ``export``, ``query``  Parquet, CSV and raw frames; SQL (``querying``); both on ``columns``
- ``tasks``              their parts that processes and machines do beside each other
- ``layouts``            the robots of logs, for ``recorder.layouts``

``recorder.reading`` finds the files and reads them.
"""
