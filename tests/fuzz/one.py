"""One target under atheris, which never returns: ``python -m tests.fuzz.one TARGET [LIBFUZZER OPTIONS]``."""

import importlib
import sys

import atheris


def main() -> None:
    with atheris.instrument_imports(include=["gateway", "recorder", "schemas"]):
        targets = importlib.import_module("tests.fuzz.targets").BY_NAME
    atheris.Setup([sys.argv[0], *sys.argv[2:]], targets[sys.argv[1]].run)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
