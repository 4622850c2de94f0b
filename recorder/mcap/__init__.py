"""The MCAP file format both ways: begin with ``reader`` and ``writer``. It opens no file.

Only this room knows how records are framed (``framing``); ``tests/test_architecture.py`` holds the tree to that.
"""
