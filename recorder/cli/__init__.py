"""The recorder's commands.

What a person can put right ends a command as a ``CommandError``: one line and an exit code.
"""
