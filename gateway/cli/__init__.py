"""The command ``cruiser``."""
