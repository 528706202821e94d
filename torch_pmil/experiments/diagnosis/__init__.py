"""What may go wrong with demonstrations before a run, and why a run did not learn after it."""
