"""Asks ``cruiser review`` as a user does."""

import argparse

from recorder.cli.review import command as review
from schemas.settings import Settings


def run(*words: object, is_stopped: bool = False) -> int:
    """The command's exit code."""
    parser = argparse.ArgumentParser()
    review.add_arguments(parser)
    return review.run(parser.parse_args([str(word) for word in words]), Settings(), lambda: is_stopped)
