"""Measure one piece of work in this process and print its row as JSON.

``prediction.py`` starts one process for each row.

Example:
    python -m benchmarks.measure torch_pmil --n 100 --horizon 25 --threads 1 --repeats 7
"""

from __future__ import annotations

import argparse
import ctypes
import json
import math
import resource
import time
from collections.abc import Callable
from pathlib import Path

import torch

from benchmarks.workloads import WORKLOADS

PATIENCE_S = 40.0  # all repeats together take no longer, but there are two at least


def main() -> None:
    """Read the command line, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("library", choices=WORKLOADS)
    for name in ("n", "horizon", "threads", "repeats"):
        parser.add_argument(f"--{name}", type=int, required=True)
    print(json.dumps(measure(**vars(parser.parse_args()))))


def measure(library: str, n: int, horizon: int, threads: int, repeats: int) -> dict[str, object]:
    """Time and memory of a value and its gradient.

    CPU and wall seconds are the least of ``repeats`` evaluations after a first one;
    ``system_seconds`` are those of the CPU seconds that the kernel took, nearly all of them to hand
    out memory.

    ``peak_mb`` (10^6 bytes) is the most memory that the process held during all of them, the model
    with its inverse Gram matrices included; ``building_peak_mb`` the most while the problem was
    made, that model's matrices among it. Left out is what it held before (libraries, the compiled
    kernels, and what they keep after a tiny evaluation). What the allocator keeps of freed memory
    counts.

    Raises:
        ValueError: the loss is not finite.
    """
    torch.set_num_threads(threads)
    make = WORKLOADS[library]
    make(5, 2)()
    forget_peak()
    before = memory_mb("VmRSS")
    evaluate = make(n, horizon)
    building_peak = memory_mb("VmHWM") - before
    forget_peak()
    start = time.perf_counter()
    loss = [tensor.item() for tensor in evaluate()[:1]]
    repeats = min(repeats, max(2, int(PATIENCE_S / (time.perf_counter() - start))))
    if not all(map(math.isfinite, loss)):
        raise ValueError(f"loss must be finite, got {loss[0]}")
    times = [timed(evaluate) for _ in range(repeats)]
    peak = memory_mb("VmHWM") - before
    return {
        "library": library,
        "n": n,
        "horizon": horizon,
        "threads": threads,
        "cpu_seconds": min(times)[0],
        "system_seconds": round(min(times)[1], 3),
        "wall_seconds": min(wall for _, _, wall in times),
        "peak_mb": round(peak, 3),
        "building_peak_mb": round(building_peak, 3),
        "repeats": repeats,
        "loss": loss[0] if loss else None,
    }


def timed(evaluate: Callable[[], object]) -> tuple[float, float, float]:
    """CPU seconds of all threads, those of them that the kernel took, and wall seconds."""
    cpu, system, wall = clocks()
    evaluate()
    cpu_end, system_end, wall_end = clocks()
    return cpu_end - cpu, system_end - system, wall_end - wall


def clocks() -> tuple[float, float, float]:
    """CPU seconds of this process, its seconds in the kernel, and wall seconds."""
    system = resource.getrusage(resource.RUSAGE_SELF).ru_stime
    return time.process_time(), system, time.perf_counter()


def memory_mb(name: str) -> float:
    """Memory of this process in 10^6 bytes, now (``VmRSS``) or at its peak (``VmHWM``).

    The peak is since it was forgotten.
    """
    lines = Path("/proc/self/status").read_text().splitlines()
    kibibytes = next(line.split()[1] for line in lines if line.startswith(f"{name}:"))
    return int(kibibytes) * 1024 / 1e6


def forget_peak() -> None:
    """Give freed memory back, and let ``VmHWM`` begin again (see proc(5), clear_refs)."""
    ctypes.CDLL(None).malloc_trim(0)
    Path("/proc/self/clear_refs").write_text("5")


if __name__ == "__main__":
    main()
