"""Keys, certificates and grants as files: made where they stay, signed where the authority is, read at a start.

What is missing, wrong or over is a ``CommandError``: one line that names the file and the cure.
"""
