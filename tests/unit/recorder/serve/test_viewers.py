"""Viewers that open a log by its address."""

import argparse

import pytest

from recorder.serve.viewers import viewer


@pytest.mark.parametrize(
    ("url", "origin"),
    [
        ("https://app.foxglove.dev/~/view", "https://app.foxglove.dev"),
        ("https://Lichtblick.example:443/?ds=x", "https://lichtblick.example"),
        ("http://127.0.0.1:8080", "http://127.0.0.1:8080"),
        ("http://[::1]:80/a", "http://[::1]"),
    ],
)
def test_the_origin_is_as_browsers_write_it(url: str, origin: str) -> None:
    """Small letters, and no port where it is the usual one: else the viewer would be refused."""
    assert viewer(url).origin == origin


@pytest.mark.parametrize(
    "url", ["", "app.foxglove.dev", "javascript:alert(1)", "file:///etc", "https://a:b", "https://u@h/"]
)
def test_what_is_no_page_is_refused(url: str) -> None:
    """Above all what would be a script in a link."""
    with pytest.raises(argparse.ArgumentTypeError, match="no address of a viewer"):
        viewer(url)
