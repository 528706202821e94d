"""PILCO on robots of gymnasium: a cost alone is enough."""

from __future__ import annotations

from pathlib import Path

import pytest

from torch_pmil import PILCO, SaturatingCost, load_policy


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_pole_is_brought_to_rest_in_the_middle(seed: int, tmp_path: Path) -> None:
    pytest.importorskip("gymnasium")
    learner = PILCO(
        "InvertedPendulum-v5",
        cost=SaturatingCost(target={"x": 0.0, "q": 0.0}, width=0.1),
        horizon=50,
        control_period=0.04,
        state=("x", "q", "dx", "dq"),
    )
    learner.learn(seed=seed, out=tmp_path / "run")
    assert learner.evaluate() >= 0.95
    assert learner.result.summary["experience_s"] <= 20
    learner.save(tmp_path / "policy.pt")
    assert load_policy(tmp_path / "policy.pt").control_period == 0.04
    learner.export(tmp_path / "policy.pt2")
    assert (tmp_path / "policy.pt2").stat().st_size > 0
    names = {path.name for path in (tmp_path / "run" / "figures").iterdir()}
    assert "trajectories.png" in names and "kl_per_step.png" not in names
    assert (tmp_path / "run" / "report.html").exists()
