"""What ``tests/promtool/run`` gives to promtool: an exposition, or the dashboard's queries as rules."""

import json
import sys

from tests.support.metrics import full_exposition, queries

if sys.argv[1] == "exposition":
    sys.stdout.write(full_exposition())
else:
    # JSON is YAML.
    rules = [{"record": f"panel:{number}", "expr": query} for number, query in enumerate(queries())]
    json.dump({"groups": [{"name": "dashboard", "rules": rules}]}, sys.stdout)
