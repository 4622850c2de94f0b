"""Keys, certificates and grants as files: created, signed by the authority, installed and checked.

A missing, wrong or expired file is a ``CommandError``: one line that names the file and the cure.
"""
