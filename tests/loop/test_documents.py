"""What the loop's documents say of an amplitude."""

import pytest

from pipeline.loop.documents import at_bound
from pipeline.loop.model import Term, limits

RULE = Term(
    "local_rule", "amplitude", "study", None, (0,), (("channel", "E"), ("feature", "walls"))
)
K = Term("wall_friction", "K", "study", None, (0,))


@pytest.mark.parametrize("term", [RULE, K])
def test_an_amplitude_at_an_end_of_its_range_is_no_fit(term):
    low, high = limits(term)
    assert at_bound(term, high)
    assert at_bound(term, low) == (low != term.described.neutral)
    assert not at_bound(term, term.described.neutral)
    assert not at_bound(term, low + 0.25 * (high - low))
