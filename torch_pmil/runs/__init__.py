"""Learning runs: their folder, figures, report and summaries, and sweeps over several."""
