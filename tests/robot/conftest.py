"""Fixtures for ``run``; a plain pytest skips this directory."""

import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.robot.box import Box
from tests.robot.image import copy_image, make_base_image
from tests.robot.outside import Outside
from tests.robot.scene import install
from tests.support.processes.gateway import chassis


@pytest.fixture
def place() -> Iterator[Path]:
    """A directory with a name short enough for sockets."""
    path = Path(tempfile.mkdtemp(prefix="robot-"))
    yield path
    shutil.rmtree(path)


@pytest.fixture
def outside(place: Path) -> Iterator[Outside]:
    with chassis("--variant", "fine") as (_, address), Outside(place, address) as wire:
        yield wire


@pytest.fixture(scope="session")
def bare_image() -> Iterator[Path]:
    directory = Path(tempfile.mkdtemp(prefix="robot-"))
    image = directory / "bare.img"
    make_base_image(image, Path(os.environ["ROBOT_CLOCK"]), os.environ["ROBOT_NS_PER_TICK"])
    yield image
    shutil.rmtree(directory)


@pytest.fixture(scope="session")
def installed_image(bare_image: Path) -> Iterator[Path]:
    """A disk with the package and its services, after a first boot."""
    directory = Path(tempfile.mkdtemp(prefix="robot-"))
    image = directory / "installed.img"
    copy_image(bare_image, image)
    with chassis("--variant", "fine") as (_, address), Outside(directory, address) as wire:
        with Box(image, directory, wire.card, os.environ["ROBOT_PROCESSOR"]) as box:
            box.boot()
            box.wait_up()
            install(box)
            box.run("systemctl enable --now cruiser-gateway cruiser-recorder", timeout_s=240)
            box.wait_status()
            box.power_off()
        assert not wire.moves_since(0)
    yield image
    shutil.rmtree(directory)


@pytest.fixture
def box(installed_image: Path, place: Path, outside: Outside) -> Iterator[Box]:
    yield from computer(installed_image, place, outside)


@pytest.fixture
def fresh_box(bare_image: Path, place: Path, outside: Outside) -> Iterator[Box]:
    yield from computer(bare_image, place, outside)


def computer(source: Path, place: Path, outside: Outside) -> Iterator[Box]:
    image = place / "box.img"
    copy_image(source, image)
    with Box(image, place, outside.card, os.environ["ROBOT_PROCESSOR"]) as computer:
        yield computer
        print(computer.console.read_text(errors="replace")[-2000:])  # noqa: T201
