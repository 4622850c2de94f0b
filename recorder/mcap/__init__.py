"""The MCAP file format both ways: begin with ``reader`` and ``writer``. It opens no file.

Only this package may import ``framing``, as ``tests/test_architecture.py`` checks.
"""
