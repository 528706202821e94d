"""The summary of a finished run, with the entries that every one has."""

from __future__ import annotations

TRIAL = {"trial": 1, "experience_s": 2.5, "success_rate": 0.5, "own_success": False}
SUMMARY = {
    "experiment": "double_pendulum",
    "seed": 3,
    "command": "pmil train seed=3",
    "wall_seconds": 12.3,
    "stop_reason": "limit of trials",
    "experience_s": 5.0,
    "saved_trial": 1,
    "saved_success_rate": 0.5,
    "saved_n_eval": 20,
    "trials": [TRIAL],
}
