"""Turns a log into answers. Each question has a function here, and a command in ``recorder.cli.review``.

The base:

- ``logs``, ``summary``, ``survey``  which files, and what their ends and heads tell
- ``pieces``, ``walk``, ``rows``     a file piece by piece; every message; the wanted ones of many files
- ``topics``, ``times``, ``faults``  how messages are read; times as people write them; what could not be read

The questions:

- ``info``, ``check``    what a log holds, as it says itself; whether that is true
- ``merge``, ``cut``     several logs in one (``joining``); a part of a log
- ``events``, ``why``    what happened (``timeline``); why the robot stopped or stood (``reasoning``)
- ``rerun``, ``what_if`` the recorded run again (``runs``, ``comparison``), and with other settings
- ``report``             a drive on one page
- ``export``, ``query``  Parquet, CSV and raw frames; SQL; both on ``columns``
- ``replay``             when to publish what again
- ``layouts``            the robots of logs, for ``recorder.layouts``
"""
