"""Alerts, their tests and page, the dashboard and the exporter name the same things.

``make metrics-rules`` checks that they are PromQL and fire when they should.
"""

from __future__ import annotations

import re
from pathlib import Path

from prometheus_client.parser import text_string_to_metric_families

from schemas.reasons import Reason
from tests.support.metrics import RULES, full_exposition, names_in, queries

ROOT = Path(__file__).parents[3]


def alerts() -> list[str]:
    return re.findall(r"^ +- alert: (\w+)$", RULES.read_text("utf-8"), flags=re.MULTILINE)


def expressions() -> str:
    return re.sub(r"^ +(annotations:|#|- alert:).*$|^#.*$", "", RULES.read_text("utf-8"), flags=re.MULTILINE)


def served() -> dict[str, set[str]]:
    found: dict[str, set[str]] = {}
    for family in text_string_to_metric_families(full_exposition()):
        for sample in family.samples:
            found.setdefault(sample.name, set()).update(sample.labels)
    return found


def test_every_alert_has_a_heading_on_the_page_and_every_heading_an_alert() -> None:
    """In the same order."""
    page = (ROOT / "docs" / "operate.md").read_text("utf-8").partition("\n## Alerts\n")[2].partition("\n## ")[0]
    assert re.findall(r"^### (\w+)$", page, flags=re.MULTILINE) == alerts()
    assert len(alerts()) == len(set(alerts()))


def test_every_alert_is_tested() -> None:
    """That it stays silent, and that it fires."""
    text = (RULES.parent / "cruiser.rules.test.yml").read_text("utf-8")
    for alert in alerts():
        assert re.search(rf"alertname: {alert}, exp_alerts: \[\]", text), alert
        assert re.search(rf"alertname: {alert}\n +exp_alerts:\n +- exp_labels", text), alert


def test_every_metric_that_is_asked_for_is_served() -> None:
    """By rules, their tests and the dashboard, with the labels that they use."""
    asked = names_in(expressions()) | names_in(" ".join(queries()))
    asked |= names_in((RULES.parent / "cruiser.rules.test.yml").read_text("utf-8"))
    assert len(asked) > 30
    assert asked - served().keys() == set()
    for text in (expressions(), *queries()):
        for name, matchers in re.findall(r"\b(cruiser_\w+)\s*\{([^}]*)\}", text):
            assert set(re.findall(r"(\w+)\s*(?:=~|!=|=)", matchers)) <= served()[name], name


def test_every_reason_that_a_rule_names_exists() -> None:
    """Another would never fire."""
    named = {reason for text in re.findall(r'reason=~"([^"]+)"', expressions()) for reason in text.split("|")}
    assert named
    assert named <= {reason.value for reason in Reason}
