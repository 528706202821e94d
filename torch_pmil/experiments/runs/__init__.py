"""One learning run and many: the folder of a run, its figures and report, and summaries of several."""
