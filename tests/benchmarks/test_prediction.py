"""The benchmark of predictions, at sizes that say nothing of speed."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import pytest
import torch

from benchmarks import prediction
from benchmarks.measure import forget_peak, measure, memory_mb
from benchmarks.workloads import (
    by_formulas,
    lengthscale_factors,
    make_problem,
    torch_pmil,
    torchrl,
)
from torch_pmil.model.compiled import prediction as kernels

TINY = [
    "--sizes",
    10,
    12,
    "--growth-sizes",
    "--growth-horizons",
    4,
    "--horizon",
    3,
    "--repeats",
    1,
    "--speedup-rounds",
    1,
]


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> None:
    monkeypatch.setattr(sys, "argv", ["benchmarks/prediction.py", *map(str, arguments)])
    prediction.main()


@pytest.fixture
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows are measured without a process for each, which would only cost time here, and with one
    thread.
    """

    def measure_here(
        library: str, n: int, horizon: int, threads: int, repeats: int, left_out: list[str]
    ) -> dict:
        return measure(library, n, horizon, 1, repeats) | {"threads": threads}

    monkeypatch.setattr(prediction, "measure", measure_here)
    monkeypatch.setattr(prediction, "cores", lambda: 2)


@pytest.mark.usefixtures("in_this_process")
def test_report_holds_rows_and_their_ratios(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Without botorch TorchRL is left out, and the report says so."""
    monkeypatch.setitem(sys.modules, "botorch", None)
    run(monkeypatch, *TINY, "--json", tmp_path / "new" / "summary.json")
    report = json.loads((tmp_path / "new" / "summary.json").read_text())
    rows = {(row["library"], row["n"], row["horizon"]): row for row in report["rows"]}
    expected = {
        (library, n, 3)
        for library in (
            "torch_pmil",
            "torch_pmil_formulas",
            "torch_pmil_fitted",
            "torch_pmil_raw_angles",
            "exp_floor",
        )
        for n in (10, 12)
    }
    assert set(rows) == expected | {("torch_pmil", 12, 4)}
    headline, ours, floor = report["headline"], rows["torch_pmil", 10, 3], rows["exp_floor", 10, 3]
    assert headline["ours_cpu_seconds_n10"] == ours["cpu_seconds"] > 0
    assert headline["ours_over_floor_n10"] == pytest.approx(
        ours["cpu_seconds"] / floor["cpu_seconds"]
    )
    assert headline["peak_mb_n12_t4"] == rows["torch_pmil", 12, 4]["peak_mb"]
    formulas = rows["torch_pmil_formulas", 10, 3]
    assert headline["formulas_over_ours_n10"] == pytest.approx(
        formulas["cpu_seconds"] / ours["cpu_seconds"]
    )
    assert headline["fitted_cpu_seconds_n12"] == rows["torch_pmil_fitted", 12, 3]["cpu_seconds"]
    assert "signal-to-noise ratios" in report["notes"]["torch_pmil_fitted"]
    assert math.isfinite(ours["loss"]) and floor["loss"] is None
    assert report["left_out"][0].startswith("torchrl: its GPWorldModel needs botorch; pip install")
    assert [row["threads"] for row in report["thread_rows"]] == [1, 2] and headline[
        "thread_speedup_n12"
    ] > 0
    assert report["commit"] and report["machine"]["cpu"]
    assert (tmp_path / "new" / "prediction.png").read_bytes()[:4] == b"\x89PNG"


def test_row_comes_from_a_process_of_its_own() -> None:
    left_out: list[str] = []
    row = prediction.measure("exp_floor", n=10, horizon=3, threads=1, repeats=2, left_out=left_out)
    assert not left_out
    assert (row["library"], row["n"], row["horizon"], row["threads"], row["repeats"]) == (
        "exp_floor",
        10,
        3,
        1,
        2,
    )


def test_failed_process_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/bin/false")
    left_out: list[str] = []
    assert (
        prediction.measure("torchrl", n=400, horizon=25, threads=1, repeats=1, left_out=left_out)
        is None
    )
    assert left_out == ["torchrl n=400 T=25: ended with status 1, no memory left?"]


def test_speed_up_is_a_ratio_of_medians() -> None:
    rows = [
        {"threads": threads, "wall_seconds": wall}
        for threads, wall in [(1, 3.0), (2, 2.0), (1, 9.0), (2, 2.0), (1, 3.2), (2, 1.0)]
    ]
    assert prediction.thread_headline(rows, 400) == {"thread_speedup_n400": 1.6}
    assert prediction.thread_headline([], 400) == {}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--sizes", "100", "1"], "error: sizes must be at least 2, got 1"),
        (["--horizon", "0"], "error: horizon must be at least 1, got 0"),
    ],
)
def test_numbers_out_of_range_are_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, arguments: list[str], message: str
) -> None:
    with pytest.raises(SystemExit) as stop:
        run(monkeypatch, *arguments, "--json", tmp_path / "summary.json")
    assert stop.value.code == message
    assert not list(tmp_path.iterdir())


def test_allocation_of_100_mb_shows_as_100_mb() -> None:
    forget_peak()
    before = memory_mb("VmRSS")
    _ = torch.ones(12_500_000, dtype=torch.float64).sum()
    assert memory_mb("VmHWM") - before == pytest.approx(100, abs=3)
    forget_peak()
    assert memory_mb("VmHWM") - before == pytest.approx(0, abs=3)


def test_outputs_have_lengthscales_of_their_own() -> None:
    factors = lengthscale_factors(4, 8)
    assert len(factors.unique()) == factors.numel()
    assert 0.5 <= factors.amin() < 0.6 and 1.8 < factors.amax() <= 2
    problem = make_problem(10, 3)
    lengthscales = problem.dynamics.expansion.lengthscales
    torch.testing.assert_close(lengthscales / lengthscales[0], factors / factors[0])


@pytest.mark.parametrize("fitted", [False, True])
def test_formulas_compute_the_same_without_kernels(
    monkeypatch: pytest.MonkeyPatch, fitted: bool
) -> None:
    """With a signal-to-noise ratio of s the numbers are known to s^2 times the rounding."""
    evaluate = torch_pmil(30, 8, fitted=fitted)
    expected = evaluate()
    monkeypatch.setattr(kernels, "predict_beliefs", None)
    for value, other in zip(by_formulas(evaluate)(), expected, strict=True):
        torch.testing.assert_close(value, other, rtol=0, atol=1e-8 * other.abs().max().item())
    with pytest.raises(TypeError):
        evaluate()


def test_torchrl_computes_the_same() -> None:
    """Loss and gradients agree up to TorchRL's jitter; its centres are in other units."""
    pytest.importorskip("botorch")
    loss, centres, weights, _ = torch_pmil(10, 8, raw_angles=True)()
    other_loss, other_centres, other_weights, _ = torchrl(10, 8)()
    scale = make_problem(10, 8, raw_angles=True).policy.scale
    torch.testing.assert_close(other_loss, loss, rtol=1e-4, atol=0)
    for gradient, other in ((weights, other_weights), (centres / scale, other_centres)):
        torch.testing.assert_close(other, gradient, rtol=0, atol=1e-3 * gradient.abs().max().item())
