"""A replayed trial whose model was right, but whose policy misses too often."""

from __future__ import annotations

from reproduction.failure_causes import ReplayedTrial

RIGHT = ReplayedTrial(
    trial=2,
    success_rate=0.8,
    n_eval=20,
    own_success=True,
    complete=True,
    predicted_before=0.85,
    predicted_after=0.85,
    samples=100,
    loss=1.0,
    miss=1.2,
    covered=0.95,
    followed=0.95,
    known=1.0,
    spread_share=None,
    coverage_ahead={"1": 0.95},
)
