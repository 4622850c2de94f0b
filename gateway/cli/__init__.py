"""The command ``cruiser``. A command ends with a ``CommandError`` where the user can put something right."""
