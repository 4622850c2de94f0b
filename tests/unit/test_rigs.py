"""What the rigs promise to the tests that use them."""

from schemas.messages import Variant
from tests.support.rigs.gateway import GatewayRig, Operator, copied, driving


def _goes_on(rig: GatewayRig, operator: Operator) -> tuple[object, ...]:
    """The outcome of a drive with a fault and a stop."""
    operator.drive(0.5, 10.0, seconds=1)
    rig.fault("bumper front on for 700ms")
    operator.drive(0.5, seconds=1)
    rig.run(2)
    return rig.now_ns, rig.out, rig.bursts, rig.heard, rig.events, rig.decided, rig.journals


def _driven_anew() -> tuple[GatewayRig, Operator]:
    rig = GatewayRig(Variant.COARSE)
    rig.run(0.6)
    operator = Operator(rig)
    operator.engage()
    operator.drive(1.0, 0.0, 2.25)
    return rig, operator


def test_a_copied_rig_goes_on_as_its_origin_and_disturbs_no_other() -> None:
    """The same frames, decisions and journal in any order."""
    first, second, third = driving(), driving(), driving()
    ways = [_goes_on(*_driven_anew()), _goes_on(*second), _goes_on(*copied(*first)), _goes_on(*first)]
    ways.append(_goes_on(*third))
    assert all(way == ways[0] for way in ways)
    assert len({id(rig.core) for rig, _ in (first, second, third)}) == 3
