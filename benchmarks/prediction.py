"""Time and memory of a predicted trajectory's KL with its policy gradient.

It measures this package, with compiled kernels and with the formulas in PyTorch, TorchRL, and the
exponentials alone. ``workloads.py`` and ``measure.py`` define what is measured and how; each row
comes from its own process.

Example:
    python -m benchmarks.prediction --sizes 50 100 200 400
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import platform
import statistics
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from benchmarks.command_line import source_of, write_summary
from benchmarks.workloads import make_problem, signal_to_noise
from torch_pmil.plotting import BLUE, GREY, VERMILLION, save_figure
from torch_pmil.plotting.style import GREEN, legend_above, style

ROOT = Path(__file__).parents[1]
THREADS = 1  # of all rows but those of the speed-up
OURS, FORMULAS, FITTED = "torch_pmil", "torch_pmil_formulas", "torch_pmil_fitted"
RAW, TORCHRL, FLOOR = "torch_pmil_raw_angles", "torchrl", "exp_floor"
NOTES = {
    OURS: "compiled kernels; model and policy see sin and cos of the two angles: 8 GP inputs",
    FORMULAS: "the same by the formulas in PyTorch, as with TORCH_PMIL_COMPILED=0",
    RAW: "model and policy see the four states themselves: 6 GP inputs, the same computation as "
    "torchrl",
    TORCHRL: "takes no sin and cos of angles: 6 GP inputs; adds 1e-6 to the raw action's "
    "covariance and 1e-8 to the state's",
    FLOOR: "D (D + 1) / 2 n^2 T exponentials by PyTorch, forward only; the kernels compute half as "
    "many for a pair of an output with itself",
}
# colour and marker
DRAWN = {
    OURS: (BLUE, "o"),
    FORMULAS: (GREEN, "D"),
    TORCHRL: (VERMILLION, "s"),
    FLOOR: (GREY, "^"),
}
LABELS = {
    OURS: "compiled",
    FORMULAS: "PyTorch formulas",
    TORCHRL: "TorchRL",
    FLOOR: "exponentials",
}


def main() -> None:
    """Measure, print, write."""
    arguments = parse_arguments()
    try:
        check(arguments)
        summary = make_summary(arguments)
        if not any(row["library"] == OURS for row in summary["rows"]):
            raise RuntimeError(f"{OURS} could not be measured")
        write_summary(arguments.json, summary)
        figure = plot(summary["rows"], arguments.horizon)
        save_figure(figure, arguments.json.with_name("prediction.png"))
    except (ValueError, OSError, RuntimeError) as error:
        sys.exit(f"error: {error}")
    print("\n".join(f"{name}: {value:.4g}" for name, value in summary["headline"].items()))


def parse_arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    whole = {"type": int, "metavar": "N"}
    parser.add_argument(
        "--sizes",
        nargs="+",
        default=[50, 100, 200, 400],
        **whole,
        help="numbers n of data for all libraries",
    )
    parser.add_argument(
        "--growth-sizes",
        nargs="*",
        default=[25, 1000],
        **whole,
        help="more of them for torch_pmil alone, compiled and by the formulas",
    )
    parser.add_argument("--horizon", default=25, **whole, help="time steps T")
    parser.add_argument(
        "--growth-horizons",
        nargs="*",
        default=[50, 100],
        **whole,
        help="more of them, at the largest of --sizes and at the largest n of all",
    )
    parser.add_argument(
        "--speedup-rounds",
        default=3,
        **whole,
        help="processes with one and with two threads, in turn; 0 for none",
    )
    parser.add_argument(
        "--repeats", default=30, **whole, help="evaluations, of which the fastest counts"
    )
    parser.add_argument(
        "--json",
        type=Path,
        default=ROOT / "results/benchmarks/prediction/summary.json",
        help="to write; the plot goes beside it",
    )
    return parser.parse_args()


def check(arguments: argparse.Namespace) -> None:
    """Raise ValueError if a number is out of range."""
    least = {
        "sizes": 2,
        "growth_sizes": 2,
        "horizon": 1,
        "growth_horizons": 1,
        "speedup_rounds": 0,
        "repeats": 1,
    }
    for name, smallest in least.items():
        values = getattr(arguments, name)
        for value in values if isinstance(values, list) else [values]:
            if value < smallest:
                raise ValueError(f"{name} must be at least {smallest}, got {value}")


def make_summary(arguments: argparse.Namespace) -> dict[str, object]:
    """Everything that the JSON file holds."""
    source = source_of("prediction")
    libraries, left_out = [FLOOR, OURS, FORMULAS, FITTED, RAW], []
    if importlib.util.find_spec("botorch"):
        libraries.append(TORCHRL)
        source["versions"]["botorch"] = version("botorch")
    else:
        left_out.append(
            f"{TORCHRL}: its GPWorldModel needs botorch; pip install -c constraints.txt -e "
            "'.[benchmark]'"
        )
        print(left_out[-1])
    columns = ("CPU s", "wall s", "peak MB", "of ours", "of floor")
    heads = "".join(f"{column:>10}" for column in columns)
    print(f"{'library':<22}{'n':>6}{'T':>5}{'threads':>9}{heads}")
    rows: list[dict] = []
    for library, n, horizon in plan(arguments, libraries):
        row = measure(library, n, horizon, THREADS, arguments.repeats, left_out)
        if row:
            rows.append(row)
            print(line(row, rows), flush=True)
    size = max(arguments.sizes)
    speedup = thread_rows(size, arguments, left_out)
    return {
        **source,
        "machine": {"cpu": cpu_model(), "cores": cores()},
        "notes": NOTES | {FITTED: note_of_fits(arguments.sizes)},
        "left_out": left_out,
        "headline": headline(rows, arguments.horizon) | thread_headline(speedup, size),
        "rows": rows,
        "thread_rows": speedup,
    }


def note_of_fits(sizes: list[int]) -> str:
    """What the fitted models are like."""
    ratios = [signal_to_noise(make_problem(n, 1, fitted=True).dynamics) for n in sizes]
    ratios = [
        f"{ratio.amin():.0f} to {ratio.amax():.0f} (n = {n})"
        for n, ratio in zip(sizes, ratios, strict=True)
    ]
    return f"as {OURS}, hyper-parameters fitted; signal-to-noise ratios {', '.join(ratios)}"


def plan(arguments: argparse.Namespace, libraries: list[str]) -> list[tuple[str, int, int]]:
    """Library, n and T of each row; what is compared is measured one after the other."""
    compared = [(library, n, arguments.horizon) for n in arguments.sizes for library in libraries]
    grown = [
        (library, n, arguments.horizon)
        for n in arguments.growth_sizes
        for library in (FLOOR, OURS, FORMULAS)
    ]
    largest = {max(arguments.sizes), max([*arguments.sizes, *arguments.growth_sizes])}
    longer = [(OURS, n, horizon) for n in sorted(largest) for horizon in arguments.growth_horizons]
    return compared + grown + longer


def measure(
    library: str, n: int, horizon: int, threads: int, repeats: int, left_out: list[str]
) -> dict | None:
    """A row from a process of its own; None, with a line in ``left_out``, if that fails."""
    numbers = {"--n": n, "--horizon": horizon, "--threads": threads, "--repeats": repeats}
    options = [str(part) for item in numbers.items() for part in item]
    command = [sys.executable, "-m", "benchmarks.measure", library, *options]
    settings = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS"), str(threads))
    settings["TORCH_PMIL_COMPILED"] = "1"
    process = subprocess.run(
        command, cwd=ROOT, env=os.environ | settings, capture_output=True, text=True, check=False
    )
    if process.returncode == 0:
        return json.loads(process.stdout.splitlines()[-1])
    reason = (process.stderr.strip().splitlines() or ["no memory left?"])[-1]
    left_out.append(
        f"{library} n={n} T={horizon}: ended with status {process.returncode}, {reason}"
    )
    print(left_out[-1])
    return None


def thread_rows(n: int, arguments: argparse.Namespace, left_out: list[str]) -> list[dict]:
    """Rows of torch_pmil with one and with two threads, in turn."""
    if cores() < 2 and arguments.speedup_rounds:
        print("one core: no speed-up of two threads to measure")
        return []
    turns = [1, 2] * arguments.speedup_rounds
    tries = [
        measure(OURS, n, arguments.horizon, threads, arguments.repeats, left_out)
        for threads in turns
    ]
    return [row for row in tries if row]


def line(row: dict, rows: list[dict]) -> str:
    """A row of the printed table.

    It has the ratios of its CPU seconds to those of ours and of the floor at the same n and T.
    """
    n, horizon = row["n"], row["horizon"]
    values = [ratio(row, find(rows, library, n, horizon)) for library in (OURS, FLOOR)]
    ratios = "".join(f"{value:>10.3g}" if value else f"{'':>10}" for value in values)
    return (
        f"{row['library']:<22}{n:>6}{horizon:>5}{row['threads']:>9}{row['cpu_seconds']:>10.4f}"
        f"{row['wall_seconds']:>10.4f}{row['peak_mb']:>10.1f}{ratios}"
    )


def find(rows: list[dict], library: str, n: int, horizon: int) -> dict | None:
    """The row of that library, n and T."""
    wanted = (library, n, horizon)
    found = (row for row in rows if (row["library"], row["n"], row["horizon"]) == wanted)
    return next(found, None)


def ratio(row: dict | None, other: dict | None) -> float | None:
    """CPU seconds of a row over those of another."""
    return row["cpu_seconds"] / other["cpu_seconds"] if row and other else None


def headline(rows: list[dict], horizon: int) -> dict[str, float]:
    """Main numbers: CPU seconds, peak memory (10^6 bytes) and ratios of CPU seconds.

    The system seconds are those of the CPU seconds in the kernel.
    """
    numbers = {}
    for row in rows:
        n, steps = row["n"], row["horizon"]
        if row["library"] == OURS:
            suffix = f"n{n}" if steps == horizon else f"n{n}_t{steps}"
            numbers[f"ours_cpu_seconds_{suffix}"] = row["cpu_seconds"]
            numbers[f"peak_mb_{suffix}"] = row["peak_mb"]
            numbers[f"ours_over_floor_{suffix}"] = ratio(row, find(rows, FLOOR, n, steps))
        elif row["library"] == FORMULAS:
            numbers[f"formulas_cpu_seconds_n{n}"] = row["cpu_seconds"]
            numbers[f"formulas_peak_mb_n{n}"] = row["peak_mb"]
            numbers[f"formulas_over_ours_n{n}"] = ratio(row, find(rows, OURS, n, steps))
        elif row["library"] == FITTED:
            numbers[f"fitted_cpu_seconds_n{n}"] = row["cpu_seconds"]
        elif row["library"] == TORCHRL:
            numbers[f"torchrl_cpu_seconds_n{n}"] = row["cpu_seconds"]
            numbers[f"torchrl_system_seconds_n{n}"] = row["system_seconds"]
            numbers[f"torchrl_peak_mb_n{n}"] = row["peak_mb"]
            numbers[f"torchrl_over_ours_n{n}"] = ratio(row, find(rows, OURS, n, steps))
            numbers[f"torchrl_over_ours_raw_angles_n{n}"] = ratio(row, find(rows, RAW, n, steps))
    return {name: value for name, value in numbers.items() if value is not None}


def thread_headline(rows: list[dict], n: int) -> dict[str, float]:
    """Wall seconds with one thread over those with two: medians over the processes."""
    one = [row["wall_seconds"] for row in rows if row["threads"] == 1]
    two = [row["wall_seconds"] for row in rows if row["threads"] == 2]
    if not (one and two):
        return {}
    return {f"thread_speedup_n{n}": statistics.median(one) / statistics.median(two)}


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0))


def cpu_model() -> str:
    """Name of the processor."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.machine())


def plot(rows: list[dict], horizon: int) -> Figure:
    """CPU seconds and peak memory over n at one horizon, a line for each library."""
    figure = Figure(figsize=(9.4, 3.8), layout="constrained")
    time, memory = figure.subplots(1, 2)
    for library in DRAWN:
        drawn = sorted(
            (row for row in rows if (row["library"], row["horizon"]) == (library, horizon)),
            key=lambda row: row["n"],
        )
        draw(time, drawn, "cpu_seconds", library)
        if library != FLOOR:
            draw(memory, drawn, "peak_mb", library)
    time.set(ylabel="CPU time (s)")
    memory.set(ylabel="peak memory (MB)")
    for panel in (time, memory):
        sizes = sorted({row["n"] for row in rows})
        panel.set(xscale="log", yscale="log", xlabel="number n of data")
        panel.set_xticks(sizes, map(str, sizes))
        panel.xaxis.set_minor_locator(NullLocator())
        style(panel)
    legend_above(figure, len(DRAWN), time)
    return figure


def draw(panel: Axes, rows: list[dict], quantity: str, library: str) -> None:
    """One line, if there is anything in it."""
    if not rows:
        return
    colour, marker = DRAWN[library]
    numbers = [row["n"] for row in rows], [row[quantity] for row in rows]
    panel.plot(*numbers, color=colour, marker=marker, markersize=5, label=LABELS[library])


if __name__ == "__main__":
    main()
