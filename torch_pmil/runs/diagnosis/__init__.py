"""Checks of demonstrations before a run, and reasons why a run did not learn after it."""
