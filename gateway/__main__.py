"""``python -m gateway`` is the same as ``cruiser``.

Its place and name are Python's rule.
"""

import sys

from gateway.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
